"""Makes `roundel.v1` from the .proto files when the package is built: they are the one schema there is.

In a clone they lie in the repository's `proto/`; a source distribution brings its own copy.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "roundel/v1"


class ProtoHook(BuildHookInterface[Any]):
    """Compiles every file of roundel/v1, and gathers what is in them in one module."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Runs before each build, of the source distribution, of the wheel, or in place."""
        root = Path(self.root)
        protos = next((p for p in (root / "proto", root / "../../proto") if (p / PACKAGE).is_dir()), None)
        if protos is None:
            raise FileNotFoundError(
                f"expected the .proto files in {root / 'proto'} (source distribution) or "
                f"{(root / '../../proto').resolve()} (clone), found neither"
            )
        if self.target_name == "sdist":
            build_data["force_include"][str(protos.resolve() / "roundel")] = "proto/roundel"
            return
        files = sorted((protos / PACKAGE).glob("*.proto"))
        out = root / "src"
        (out / PACKAGE).mkdir(parents=True, exist_ok=True)
        compile_protos(protos, files, out)
        (out / PACKAGE / "__init__.py").write_text(gathered(files, out / PACKAGE), encoding="utf-8")


def compile_protos(protos: Path, files: list[Path], out: Path) -> None:
    """Writes a module and its types for each file."""
    from grpc_tools import protoc

    google = resources.files("grpc_tools") / "_proto"
    names = [str(file.relative_to(protos)) for file in files]
    options = [f"-I{protos}", f"-I{google}", f"--python_out={out}", f"--pyi_out={out}"]
    if protoc.main(["protoc", *options, *names]) != 0:
        raise RuntimeError(f"protoc refuses the files in {protos / PACKAGE}; it says why above")


def gathered(files: list[Path], folder: Path) -> str:
    """A module with every message and enumeration of the generated ones."""
    lines = ['"""Every message of package roundel.v1, as in the .proto files. Generated."""', ""]
    for file in files:
        module = f"{file.stem}_pb2"
        # The types name what is public, one definition a line.
        stub = (folder / f"{module}.pyi").read_text(encoding="utf-8").splitlines()
        classes = [line.split()[1].split("(")[0] for line in stub if line.startswith("class ")]
        values = [line.split(":")[0] for line in stub if line[:1].isupper() and ": " in line]
        for name in sorted([*classes, *(v for v in values if v != "DESCRIPTOR")]):
            lines.append(f"from roundel.v1.{module} import {name} as {name}")
    return "\n".join(lines) + "\n"
