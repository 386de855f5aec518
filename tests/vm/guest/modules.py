"""The kernel's modules."""

from __future__ import annotations

import subprocess


def modprobe(*modules: str) -> None:
    """Loads modules; what is loaded already stays as it is. Parameters stand behind a module's name."""
    for module in modules:
        subprocess.run(["/bin/busybox", "modprobe", *module.split()], check=True)
