"""Runs a script as root in a throw-away VM: QEMU's software emulation, since no test may depend
on /dev/kvm.
"""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from image import Image

# Boot takes some five seconds on an idle machine; a busy one is several times slower.
LIMIT_S = 400.0
KERNEL_OPTIONS = "console=ttyS0 quiet panic=-1 nokaslr mitigations=off"


@dataclass(frozen=True)
class Outcome:
    """How the VM ended."""

    exit_code: int | None
    """What the script returned; None if the VM ended before it did."""
    boot_s: float
    """Guest's time from the kernel's start to the script's; NaN if it never started."""
    total_s: float
    """Wall time from the start of QEMU to power-off."""
    console: str


def run(
    image: Image, script: str, out: Path, limit_s: float = LIMIT_S, devices: Sequence[str] = ()
) -> Outcome:
    """Runs a shell script that sees the host's root file system read-only and `out` as ``/out``; `devices`
    are more of QEMU's arguments.
    """
    (out / "run.sh").write_text(script, encoding="utf-8")
    command: list[str] = [shutil.which("qemu-system-x86_64") or "qemu-system-x86_64"]
    # One processor: with two, a host of two busy cores showed stalls of the guest's kernel.
    command += ["-M", "q35,accel=tcg,usb=off", "-bios", "qboot.rom", "-cpu", "max", "-smp", "1", "-m", "1024"]
    command += ["-nodefaults", "-no-reboot", "-display", "none", "-serial", "stdio"]
    command += ["-kernel", str(image.kernel), "-initrd", str(image.initrd), "-append", KERNEL_OPTIONS]
    command += shared("host", Path("/"), read_only=True) + shared("out", out, read_only=False)
    command += devices
    start = time.monotonic()
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", check=False, timeout=limit_s
        )
        console = f"{done.stdout}{done.stderr}\nQEMU ended with {done.returncode}"
    except subprocess.TimeoutExpired as error:
        partial = error.stdout or b""
        console = partial.decode(errors="replace") if isinstance(partial, bytes) else partial
        console += f"\nended by force after {limit_s:.0f} s"
    total_s = time.monotonic() - start
    code = number(out / "exit_code")
    return Outcome(None if code != code else int(code), number(out / "booted_s"), total_s, console)


def shared(tag: str, path: Path, *, read_only: bool) -> list[str]:
    """A folder of the host that the guest mounts by 9p under this tag."""
    options = f"local,id={tag},path={path},security_model=none,multidevs=remap"
    if read_only:
        options += ",readonly=on"
    return ["-fsdev", options, "-device", f"virtio-9p-pci,fsdev={tag},mount_tag={tag}"]


def number(path: Path) -> float:
    try:
        return float(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return float("nan")
