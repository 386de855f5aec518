"""Provenance of results: the build of the package, its inputs, and the machine."""

from __future__ import annotations

import hashlib
import os
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import gelstereo
import gelstereo_bench
from gelstereo.tune.cache import processor

__all__ = ["build_digest", "digest_of", "machine", "processor", "versions"]

_LIBRARIES = ("numpy", "opencv-contrib-python-headless", "scipy", "trimesh", "matplotlib")


@cache
def build_digest() -> str:
    """SHA-256 over the files of the package, including its compiled module, and of the benchmarks."""
    found = hashlib.sha256()
    for package in (gelstereo, gelstereo_bench):
        root = Path(package.__path__[0])
        files = (path for path in root.rglob("*") if path.suffix in (".py", ".so", ".pyd"))
        for path in sorted(files, key=lambda path: path.relative_to(root).as_posix()):
            found.update(path.relative_to(root).as_posix().encode() + b"\0")
            found.update(hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()


def digest_of(text: str) -> str:
    """SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()


def machine() -> str:
    """Description of the machine for reports: processor, cores and system."""
    return f"{processor()}, {os.cpu_count()} cores, {platform.system()} {platform.machine()}"


def versions() -> dict[str, str]:
    """Versions of Python, of the package, and of the libraries that affect results."""
    found = {"gelstereo": gelstereo.__version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
