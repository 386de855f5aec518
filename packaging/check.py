"""Checks what `make dist` made: `check.py WHEEL_OR_BINARY...`."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
PACKAGE = REPOSITORY / "python" / "gelstereo"

#: A robot's computer may have a small disk.
MAX_BINARY_BYTES = 8_000_000


def wanted() -> set[str]:
    """Files that a wheel has besides modules: scenes, stubs, the mark of a typed package, and
    licence texts.
    """
    files = [
        path
        for path in PACKAGE.rglob("*")
        if path.is_file() and path.suffix in (".toml", ".stl", ".pyi", ".html")
    ]
    return {
        *(f"gelstereo/{path.relative_to(PACKAGE)}" for path in files),
        "gelstereo/py.typed",
        "gelstereo/_native.abi3.so",
        "gelstereo/third-party-licences.txt",
    }


def faults_of_wheel(names: set[str]) -> list[str]:
    """What a wheel with these files lacks."""
    faults = [f"has no {name}" for name in sorted(wanted() - names)]
    if not any(name.endswith(".dist-info/licenses/LICENSE") for name in names):
        faults.append("has no LICENSE")
    return faults


def faults_of_binary(size_bytes: int) -> list[str]:
    """Whether a binary is too large."""
    if size_bytes > MAX_BINARY_BYTES:
        return [f"has {size_bytes} bytes; valid is {MAX_BINARY_BYTES} or less"]
    return []


def faults(path: Path) -> list[str]:
    """What is wrong with a file."""
    if path.suffix == ".whl":
        with zipfile.ZipFile(path) as wheel:
            return faults_of_wheel(set(wheel.namelist()))
    return faults_of_binary(path.stat().st_size)


def main(paths: list[str]) -> int:
    """Print what is wrong; return the exit code."""
    found = [f"{path} {fault}" for path in paths for fault in faults(Path(path))]
    print(*found, sep="\n", end="\n" if found else "", file=sys.stderr)
    return bool(found)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
