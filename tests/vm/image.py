"""Kernel and initial RAM disk of the device tests' VM, from Debian's stock kernel package.

They are kept in a folder that git ignores and are made again when the package or this code changes.
"""

from __future__ import annotations

import hashlib
import lzma
import os
import shutil
import subprocess
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).resolve().parent
ENVIRONMENT = {**os.environ, "PATH": os.environ.get("PATH", "") + ":/usr/sbin:/sbin", "LC_ALL": "C"}
# The VM's own, then: cameras, USB devices made in user space, HID devices made in user space, lights, serial
# adapters. A network card reaches devices that are made outside the VM.
MODULES = (
    ["virtio_pci", "9p", "9pnet_virtio", "overlay"]
    + ["uvcvideo", "vivid", "vhci-hcd"]
    + ["usbhid", "hid-generic", "uhid", "hid-led"]
    + ["xhci-pci", "ftdi_sio", "cdc-acm", "virtio_net"]
)


class Unavailable(Exception):
    """The VM cannot be made or run here; the message says what is missing."""


@dataclass(frozen=True)
class Image:
    """What QEMU boots."""

    kernel: Path
    initrd: Path


def run(*command: str | Path, **options: object) -> str:
    """Standard output of a command that must succeed."""
    done = subprocess.run(  # type: ignore[call-overload]
        command, env=ENVIRONMENT, check=False, capture_output=True, text=True, **options
    )
    if done.returncode != 0:
        raise Unavailable(f"{' '.join(map(str, command))} failed: {done.stderr.strip()[-500:]}")
    return str(done.stdout)


def require_tools() -> None:
    """Raises `Unavailable` naming every program that is missing."""
    wanted = ["qemu-system-x86_64", "busybox", "depmod", "modprobe", "cpio", "apt-get", "dpkg-deb"]
    missing = [tool for tool in wanted if shutil.which(tool, path=ENVIRONMENT["PATH"]) is None]
    if missing:
        raise Unavailable(
            f"not installed: {', '.join(missing)} (.ci/long-prerequisites.sh installs them on Debian)"
        )
    if os.uname().machine != "x86_64":
        raise Unavailable(f"the VM runs the host's x86-64 programs; this is {os.uname().machine}")


def build(cache: Path) -> Image:
    """The image for the kernel that apt offers, from the cache where it is there already."""
    require_tools()
    cache.mkdir(parents=True, exist_ok=True)
    # Names of modules come back without symbolic links.
    cache = cache.resolve()
    package = kernel_package()
    recipe = b"".join((HERE / name).read_bytes() for name in ("image.py", "init"))
    image = cache / f"{package}-{hashlib.sha256(recipe).hexdigest()[:12]}"
    if not (image / "initrd.cpio").exists():
        with TemporaryDirectory(dir=cache) as scratch:
            make(package, cache, Path(scratch))
            shutil.rmtree(image, ignore_errors=True)
            (Path(scratch) / "image").rename(image)
    return Image(image / "vmlinux", image / "initrd.cpio")


def kernel_package() -> str:
    """Name of the versioned package behind Debian's ``linux-image-amd64``."""
    for line in run("apt-cache", "depends", "linux-image-amd64").splitlines():
        kind, _, name = line.strip().partition(": ")
        if kind == "Depends" and name.startswith("linux-image-"):
            return name
    raise Unavailable("apt knows no linux-image-amd64; run .ci/long-prerequisites.sh on Debian")


def make(package: str, cache: Path, scratch: Path) -> None:
    """Writes ``scratch/image``."""
    archives = sorted(cache.glob(f"{package}_*.deb"))
    if not archives:
        run("apt-get", "download", package, cwd=cache)
        archives = sorted(cache.glob(f"{package}_*.deb"))
    tree, image, release = scratch / "tree", scratch / "image", package.removeprefix("linux-image-")
    run("dpkg-deb", "-x", archives[-1], tree)
    run("depmod", "-b", tree, release)
    image.mkdir()
    (image / "vmlinux").write_bytes(unpacked_kernel((tree / "boot" / f"vmlinuz-{release}").read_bytes()))
    (image / "initrd.cpio").write_bytes(initrd(tree, release, scratch / "initrd"))


def unpacked_kernel(packed: bytes) -> bytes:
    """The ELF file in a bzImage: under software emulation the guest would take seconds to unpack it at every
    boot.
    """
    kinds: list[tuple[bytes, Callable[[bytes], bytes]]] = [
        (b"\xfd7zXZ\x00", lambda data: lzma.LZMADecompressor().decompress(data)),
        (b"\x1f\x8b\x08", lambda data: zlib.decompressobj(31).decompress(data)),
        (b"\x28\xb5\x2f\xfd", unpacked_zstd),
    ]
    for magic, unpack in kinds:
        for start in positions(packed, magic):
            try:
                kernel = unpack(packed[start:])
            except (lzma.LZMAError, zlib.error):
                continue
            if kernel.startswith(b"\x7fELF"):
                return kernel
    raise Unavailable("the kernel image holds no xz, gzip or zstd payload")


def unpacked_zstd(packed: bytes) -> bytes:
    # What follows the payload makes the program fail after it wrote the kernel.
    return subprocess.run(["zstd", "-dcq"], input=packed, capture_output=True, check=False).stdout


def positions(data: bytes, pattern: bytes) -> Iterator[int]:
    start = data.find(pattern)
    while start >= 0:
        yield start
        start = data.find(pattern, start + 1)


def initrd(tree: Path, release: str, root: Path) -> bytes:
    """A cpio archive of busybox, `init` and the modules with all that they depend on."""
    for folder in ("bin", "sbin", "dev", "proc", "sys"):
        (root / folder).mkdir(parents=True)
    busybox = shutil.which("busybox", path=ENVIRONMENT["PATH"])
    assert busybox is not None
    shutil.copy(busybox, root / "bin" / "busybox")
    # The kernel itself starts this one when it wants a module.
    (root / "sbin" / "modprobe").symlink_to("/bin/busybox")
    shutil.copy(HERE / "init", root / "init")
    (root / "init").chmod(0o755)
    modules = Path("lib") / "modules" / release
    for path in module_files(tree, release):
        target = root / modules / path.relative_to(tree / modules)
        target.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".xz":
            target.with_suffix("").write_bytes(lzma.decompress(path.read_bytes()))
        else:
            shutil.copy(path, target)
    for name in ("modules.builtin", "modules.order"):
        shutil.copy(tree / modules / name, root / modules / name)
    run("depmod", "-b", root, release)
    names = "\n".join(str(path.relative_to(root)) for path in sorted(root.rglob("*"))) + "\n"
    archive = subprocess.run(
        ["cpio", "-o", "-H", "newc", "--quiet"],
        input=names.encode(),
        cwd=root,
        capture_output=True,
        check=True,
    )
    return archive.stdout


def module_files(tree: Path, release: str) -> list[Path]:
    """Files of `MODULES` and all that they need."""
    found: set[Path] = set()
    for module in MODULES:
        shown = run("modprobe", "-d", tree, "-S", release, "--show-depends", module)
        found |= {
            Path(line.split()[1]).resolve() for line in shown.splitlines() if line.startswith("insmod ")
        }
    return sorted(found)
