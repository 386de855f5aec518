"""Builds and runs ``examples/bare_metal`` for a chip, and reads what it prints and how large it is."""

from __future__ import annotations

import re
import shutil
import statistics
import struct
import subprocess
from dataclasses import dataclass
from pathlib import Path

from gelstereo_bench.reports.markdown import ReportError

__all__ = [
    "CHIPS",
    "SIZES",
    "Build",
    "Chip",
    "Cost",
    "Firmware",
    "Used",
    "measure",
    "missing",
    "read",
    "section_bytes",
]

#: Frames over which the map from pixels to points is fitted in steps; a later one is a tracked frame.
_FITTED_BY = 9

#: Several times what the slowest run takes.
_MAX_RUN_S = 1800.0


@dataclass(frozen=True)
class Chip:
    """A processor of QEMU, with the board's name in ``examples/bare_metal/boards``."""

    name: str
    board: str
    target: str
    emulator: str
    #: Rated clock of a common part: STM32F429, STM32H743, BCM2837B0.
    clock_mhz: int


CHIPS = (
    Chip("Cortex-M4F", "mps2-an386", "thumbv7em-none-eabihf", "qemu-system-arm", 180),
    Chip("Cortex-M7", "mps2-an500", "thumbv7em-none-eabihf", "qemu-system-arm", 480),
    Chip("Cortex-A53", "virt", "aarch64-unknown-none", "qemu-system-aarch64", 1400),
)

#: The board of the example's own configuration.
_DEFAULT_BOARD = CHIPS[0].board

#: Image sizes, and the features of the example that select them.
SIZES: dict[str, list[str]] = {"160x120": ["qqvga"], "320x240": [], "640x480": ["vga"]}


@dataclass(frozen=True)
class Build:
    """One build of the example."""

    chip: Chip
    #: A key of `SIZES`.
    size: str = "320x240"
    pose: bool = True
    opt_level: str = "3"

    @property
    def name(self) -> str:
        """Words for a progress bar."""
        what = "pose" if self.pose else "sensing"
        return f"{self.chip.name}, {self.size}, {what}, opt-level {self.opt_level}"

    def words(self, target_dir: Path) -> list[str]:
        """Options of Cargo, from the example's folder."""
        features = ["pose"] * self.pose + SIZES[self.size]
        level = self.opt_level if self.opt_level.isdigit() else f'"{self.opt_level}"'
        words = ["--release", "--quiet", "--locked", "--target-dir", str(target_dir)]
        words += ["--no-default-features", "--features", ",".join(features)]
        words += ["--config", f"profile.release.opt-level={level}"]
        if self.chip.board != _DEFAULT_BOARD:
            words += ["--config", f"boards/{self.chip.board}.toml"]
        return words


@dataclass(frozen=True)
class Used:
    """Memory: most bytes of heap in use, end of the highest block of the heap, most bytes of stack."""

    heap_bytes: int
    reach_bytes: int
    stack_bytes: int


@dataclass(frozen=True)
class Cost:
    """Instructions and memory of a preset; registration takes 0 instructions if it was not built."""

    rest: int
    tracked: float
    #: Of all frames but the rest frame.
    largest: int
    sensing: Used
    registration: int
    pose: Used
    verdict: str


@dataclass(frozen=True)
class Firmware:
    """What a build printed, and its sizes."""

    #: Image size and markers.
    images: str
    #: Instructions of the loop that checks the counter: executed and counted.
    loop: tuple[int, int]
    presets: dict[str, Cost]
    #: Without images and template.
    flash_bytes: int
    static_bytes: int
    text: str


def missing(chip: Chip) -> str | None:
    """What this machine lacks to build and run for a chip, and how to get it; None if it has all."""
    if shutil.which("cargo") is None:
        return "cargo (install rustup)"
    if shutil.which(chip.emulator) is None:
        return f"{chip.emulator} (apt-get install qemu-system-arm)"
    asked = ["rustc", "--print", "target-libdir", "--target", chip.target]
    found = subprocess.run(asked, capture_output=True, text=True, check=False)
    if not (found.returncode == 0 and Path(found.stdout.strip()).is_dir()):
        return f"Rust's library for {chip.target} (rustup target add {chip.target})"
    return None


def measure(example: Path, build: Build) -> Firmware:
    """Build the example, run it, and read its output and its sizes.

    Parameters
    ----------
    example
        The folder ``examples/bare_metal``.
    build
        What to build.

    Raises
    ------
    ReportError
        A tool is missing, the build fails, or the program does.
    """
    lacks = missing(build.chip)
    if lacks is not None:
        raise ReportError(f"{build.name} needs {lacks}")
    target_dir = example.resolve().parents[1] / "target" / "bare_metal"
    command = ["cargo", "run", *build.words(target_dir)]
    try:
        done = subprocess.run(
            command, cwd=example, capture_output=True, text=True, check=False, timeout=_MAX_RUN_S
        )
    except subprocess.TimeoutExpired:
        raise ReportError(f"{build.name} did not end within {_MAX_RUN_S:.0f} s") from None
    if done.returncode != 0:
        raise ReportError(f"{build.name} failed:\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    sections = section_bytes((target_dir / build.chip.target / "release" / "bare-metal").read_bytes())
    return read(done.stdout, sections)


def read(text: str, sections: tuple[int, int]) -> Firmware:
    """Read the output of the example; `sections` are its bytes of flash and of static data."""
    images = _words(r"images (\d+) x (\d+), markers (\d+) x (\d+)", text)
    data_bytes = int(_words(r"images and template (\d+) bytes", text)[0])
    loop = _words(r"a loop of (\d+) instructions counts as (\d+)", text)
    return Firmware(
        images="{}x{}, {}x{}".format(*images),
        loop=(int(loop[0]), int(loop[1])),
        presets={part.split("\n", 1)[0]: _cost(part) for part in re.split(r"(?m)^preset ", text)[1:]},
        flash_bytes=sections[0] - data_bytes,
        static_bytes=sections[1],
        text=text,
    )


def _cost(text: str) -> Cost:
    counts = [int(count) for count in re.findall(r"frame \d+: .* (\d+) instructions", text)]
    if len(counts) <= _FITTED_BY:
        raise ReportError(
            f"the example printed {len(counts)} frames of a preset; expected more than {_FITTED_BY}"
        )
    sensing = _used("sensing", text)
    has_pose = re.search(r"registration: ", text) is not None
    registration = _words(r"registration: (\d+) instructions, (\w+)", text) if has_pose else ("0", "-")
    return Cost(
        rest=counts[0],
        tracked=statistics.median(counts[_FITTED_BY:]),
        largest=max(counts[1:]),
        sensing=sensing,
        registration=int(registration[0]),
        pose=_used("pose", text) if has_pose else sensing,
        verdict=registration[1],
    )


def _used(what: str, text: str) -> Used:
    heap, reach, stack = _words(rf"{what}: heap (\d+) bytes, reach (\d+) bytes, stack (\d+) bytes", text)
    return Used(int(heap), int(reach), int(stack))


def _words(pattern: str, text: str) -> tuple[str, ...]:
    found = re.search(pattern, text)
    if found is None:
        raise ReportError(f"the example printed no line like {pattern!r}, but:\n{text[-2000:]}")
    return found.groups()


def section_bytes(elf: bytes) -> tuple[int, int]:
    """Bytes of flash and of static data of a little-endian ELF file, of 32 or 64 bits.

    Flash holds all sections that are loaded, static data is what of them can be written, and what starts as
    zero.

    Raises
    ------
    ReportError
        The bytes are no such file.
    """
    if len(elf) < 64 or elf[:4] != b"\x7fELF" or elf[4] not in (1, 2) or elf[5] != 1:
        raise ReportError("the program is no little-endian ELF file")
    is_64 = elf[4] == 2
    (table_at,) = struct.unpack_from("<Q" if is_64 else "<I", elf, 0x28 if is_64 else 0x20)
    entry_bytes, count = struct.unpack_from("<HH", elf, 0x3A if is_64 else 0x2E)
    flash = static = 0
    for at in range(table_at, table_at + entry_bytes * count, entry_bytes):
        kind, flags, _, _, size = struct.unpack_from("<IQQQQ" if is_64 else "<IIIII", elf, at + 4)
        is_allocated, is_written, is_zero = bool(flags & 2), bool(flags & 1), kind == 8
        if is_allocated:
            flash += 0 if is_zero else size
            static += size if is_zero or is_written else 0
    return flash, static
