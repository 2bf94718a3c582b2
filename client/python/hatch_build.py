"""Generates `roundel.v1` from the .proto files when the package is built.

The files come from `proto/` of the repository; a source distribution contains its own copy.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "roundel/v1"


class ProtoHook(BuildHookInterface[Any]):
    """Compiles every file of roundel/v1 and re-exports their messages from one module."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Runs before each build of a source distribution, wheel or editable install."""
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
        (out / PACKAGE / "__init__.py").write_text(reexports(files, out / PACKAGE), encoding="utf-8")


def compile_protos(protos: Path, files: list[Path], out: Path) -> None:
    """Writes a module and its type stub for each file."""
    from grpc_tools import protoc

    google = resources.files("grpc_tools") / "_proto"
    names = [str(file.relative_to(protos)) for file in files]
    options = [f"-I{protos}", f"-I{google}", f"--python_out={out}", f"--pyi_out={out}"]
    if protoc.main(["protoc", *options, *names]) != 0:
        raise RuntimeError(f"protoc rejects the files in {protos / PACKAGE}; see its errors above")


def reexports(files: list[Path], folder: Path) -> str:
    """The source of a module that re-exports every generated message, enumeration and enumeration value."""
    lines = ['"""Every message of package roundel.v1, as in the .proto files. Generated."""', ""]
    for file in files:
        module = f"{file.stem}_pb2"
        # The stub has one public definition per line.
        stub = (folder / f"{module}.pyi").read_text(encoding="utf-8").splitlines()
        classes = [line.split()[1].split("(")[0] for line in stub if line.startswith("class ")]
        values = [line.split(":")[0] for line in stub if line[:1].isupper() and ": " in line]
        for name in sorted([*classes, *(v for v in values if v != "DESCRIPTOR")]):
            lines.append(f"from roundel.v1.{module} import {name} as {name}")
    return "\n".join(lines) + "\n"
