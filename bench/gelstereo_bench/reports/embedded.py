"""Flash, RAM and instructions of the core without an operating system, on processors that QEMU emulates.

Run ``python -m gelstereo_bench.reports.embedded`` to fill docs/embedded.md. It builds ``examples/bare_metal``
for every chip, image size and set of features, and runs the result. It needs Cargo, the Rust targets of
`CHIPS`, and QEMU's ``qemu-system-arm`` and ``qemu-system-aarch64``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from gelstereo.progress import Progress
from gelstereo_bench.reports.firmware import CHIPS, SIZES, Build, Chip, Cost, Firmware, measure
from gelstereo_bench.reports.markdown import replace_between, table

__all__ = ["flash_table", "instruction_table", "main", "memory_table", "small_table", "time_table"]

_M4 = CHIPS[0]


def _kib(size_bytes: int) -> str:
    return f"{size_bytes / 1024:.0f}"


def _figure(value: float) -> str:
    return f"{value:.3g}" if value < 1000.0 else f"{value:.0f}"


def _millions(count: float) -> str:
    return _figure(count / 1e6)


def _milliseconds(count: float, chip: Chip) -> str:
    return _figure(count / (1e3 * chip.clock_mhz))


def _rows(found: dict[Build, Firmware]) -> list[tuple[Build, str, str, Cost]]:
    """Build, image size, preset and cost of everything that was run with registration."""
    return [
        (build, firmware.images, preset, cost)
        for build, firmware in found.items()
        if build.pose and build.opt_level == "3"
        for preset, cost in firmware.presets.items()
    ]


def flash_table(found: dict[Build, Firmware]) -> str:
    """Code, constants and initialised data, without images and template."""
    rows = []
    for chip in CHIPS:
        sensing, pose = (found[Build(chip, pose=pose)] for pose in (False, True))
        sizes = [_kib(firmware.flash_bytes) for firmware in (sensing, pose)]
        rows.append([chip.name, *sizes, f"{pose.static_bytes}"])
    return table(["chip", "sensing, KiB", "with registration, KiB", "static data, bytes"], rows)


def memory_table(found: dict[Build, Firmware]) -> str:
    """Heap and stack of every preset."""
    head = ["images, markers", "chip", "preset", "sensing: heap KiB", "to provide KiB", "stack KiB"]
    head += ["with registration: heap KiB", "to provide KiB", "stack KiB"]
    rows = []
    for build, images, preset, cost in _rows(found):
        sizes = [
            _kib(size)
            for used in (cost.sensing, cost.pose)
            for size in (used.heap_bytes, used.reach_bytes, used.stack_bytes)
        ]
        rows.append([images, build.chip.name, preset, *sizes])
    return table(head, rows)


def instruction_table(found: dict[Build, Firmware]) -> str:
    """Millions of instructions of frames and of a registration."""
    head = [
        "images, markers",
        "chip",
        "preset",
        "rest frame",
        "tracked frame",
        "largest of the others",
        "registration",
        "verdict",
    ]
    rows = [
        [images, build.chip.name, preset]
        + [_millions(count) for count in (cost.rest, cost.tracked, cost.largest, cost.registration)]
        + [cost.verdict]
        for build, images, preset, cost in _rows(found)
    ]
    return table(head, rows)


def time_table(found: dict[Build, Firmware]) -> str:
    """Milliseconds of a tracked frame and of a registration at one instruction a cycle."""
    head = ["images, markers", "preset"]
    head += [
        f"{chip.name}, {chip.clock_mhz} MHz: {what}" for chip in CHIPS for what in ("frame", "registration")
    ]
    cells: dict[tuple[str, str], list[str]] = {}
    for build, images, preset, cost in _rows(found):
        times = [_milliseconds(count, build.chip) for count in (cost.tracked, cost.registration)]
        cells.setdefault((images, preset), []).extend(times)
    return table(head, [[*key, *row] for key, row in cells.items()])


def small_table(found: dict[Build, Firmware]) -> str:
    """Effect of the compiler's optimisation for size on the Cortex-M4F."""
    rows = []
    for level, what in (("3", "speed"), ("s", "size")):
        sensing, pose = (found[Build(_M4, pose=pose, opt_level=level)] for pose in (False, True))
        costs = [pose.presets[preset] for preset in ("fast", "balanced")]
        rows.append(
            [
                f"{what} (`opt-level = {level}`)".replace("= s", '= "s"'),
                _kib(sensing.flash_bytes),
                _kib(pose.flash_bytes),
            ]
            + [_millions(cost.tracked) for cost in costs]
            + [_millions(cost.registration) for cost in costs]
        )
    head = ["optimised for", "sensing, KiB", "with registration, KiB", "frame, fast", "frame, balanced"]
    return table([*head, "registration, fast", "registration, balanced"], rows)


def _builds() -> list[Build]:
    """Everything that the page states, by image size and chip."""
    whole = [Build(chip, size) for size in SIZES for chip in CHIPS]
    sensing = [Build(chip, pose=False) for chip in CHIPS]
    return [*whole, *sensing, *(Build(_M4, pose=pose, opt_level="s") for pose in (False, True))]


def main(arguments: Sequence[str] | None = None) -> None:
    """Fill the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, default=Path("docs/embedded.md"))
    parser.add_argument("--example", type=Path, default=Path("examples/bare_metal"))
    chosen = parser.parse_args(arguments)
    builds, found = _builds(), {}
    with Progress("building and running") as shown:
        for done, build in enumerate(builds):
            shown(done, len(builds), build.name)
            found[build] = measure(chosen.example, build)
        shown(len(builds), len(builds))
    tables = {"flash": flash_table, "memory": memory_table, "instructions": instruction_table}
    for name, write in {**tables, "times": time_table, "small": small_table}.items():
        replace_between(chosen.page, name, write(found))


if __name__ == "__main__":
    main()
