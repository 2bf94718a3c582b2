"""Generates the blocking client from the asyncio client with unasync.

    pip install unasync
    python client/python/generate_sync.py

Writes `client.py` and `_snapshots.py` of `src/roundel` from the files of the same names in `src/roundel/aio`. Replaces
`async` syntax by its blocking form, and each `Async…` class of `_concurrency.py` by its `Sync…` class. A test fails while
the committed files differ from the generated ones.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

import unasync

PACKAGE = Path(__file__).resolve().parent / "src/roundel"
FILES = ("client.py", "_snapshots.py")
HEADER = "# Generated from aio/{name} by generate_sync.py. Do not edit.\n"


def generate(out: Path) -> None:
    """Writes the blocking client into the folder `out`."""
    with tempfile.TemporaryDirectory() as folder:
        rule = unasync.Rule(fromdir="/aio/", todir="/blocking/")
        source = Path(folder) / "aio"
        source.mkdir()
        for name in FILES:
            shutil.copy(PACKAGE / "aio" / name, source)
        unasync.unasync_files([str(source / name) for name in FILES], [rule])
        for name in FILES:
            text = (Path(folder) / "blocking" / name).read_text(encoding="utf-8")
            (out / name).write_text(HEADER.format(name=name) + text, encoding="utf-8")


if __name__ == "__main__":
    generate(PACKAGE)
