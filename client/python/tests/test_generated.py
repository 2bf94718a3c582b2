"""The committed blocking client is the one that `generate_sync.py` makes of the asyncio client."""

from __future__ import annotations

import runpy
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def test_the_blocking_client_is_generated_from_the_asyncio_client(tmp_path: Path) -> None:
    script = runpy.run_path(str(PACKAGE / "generate_sync.py"))
    script["generate"](tmp_path)
    for name in script["FILES"]:
        committed = (PACKAGE / "src/roundel" / name).read_text(encoding="utf-8")
        assert committed == (tmp_path / name).read_text(encoding="utf-8"), f"{name}: run generate_sync.py"
