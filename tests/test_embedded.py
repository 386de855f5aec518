"""The example without an operating system gives this machine's bits on an emulated processor; its report
reads what it prints.
"""

from __future__ import annotations

import os
import re
import shutil
import struct
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelstereo_bench.reports.embedded import (
    flash_table,
    instruction_table,
    memory_table,
    small_table,
    time_table,
)
from gelstereo_bench.reports.firmware import (
    CHIPS,
    SIZES,
    Build,
    Firmware,
    measure,
    missing,
    read,
    section_bytes,
)
from gelstereo_bench.reports.markdown import ReportError

REPOSITORY = Path(__file__).parents[1]
EXAMPLE = REPOSITORY / "examples" / "bare_metal"
PRESETS = ("paper", "fast", "balanced", "exact")

numbers = st.integers(0, 10**12)
memory = st.tuples(numbers, numbers, numbers)


def printed(counts: list[int], sensing: tuple[int, ...], pose: tuple[int, ...], registration: int) -> str:
    """Output of the example, with the same costs of every preset."""
    lines = ["images 320 x 240, markers 11 x 11", "heap 99 bytes, images and template 7 bytes"]
    lines.append("a loop of 2000 instructions counts as 2040")
    for name in PRESETS:
        lines.append(f"preset {name}")
        lines += [
            f"  frame {i}: 121 points, 3 in contact, {count} instructions" for i, count in enumerate(counts)
        ]
        lines.append("  sensing: heap {} bytes, reach {} bytes, stack {} bytes".format(*sensing))
        lines.append(f"  registration: {registration} instructions, Fits")
        lines.append("  pose: heap {} bytes, reach {} bytes, stack {} bytes".format(*pose))
    return "\n".join(lines)


@given(st.lists(numbers, min_size=12, max_size=20), memory, memory, numbers)
def test_what_the_example_prints_is_read(
    counts: list[int], sensing: tuple[int, ...], pose: tuple[int, ...], registration: int
) -> None:
    found = read(printed(counts, sensing, pose, registration), (1007, 5))
    assert (found.images, found.loop, found.flash_bytes, found.static_bytes) == (
        "320x240, 11x11",
        (2000, 2040),
        1000,
        5,
    )
    assert tuple(found.presets) == PRESETS
    for cost in found.presets.values():
        assert (cost.rest, cost.largest, cost.registration) == (counts[0], max(counts[1:]), registration)
        assert sorted(counts[9:])[0] <= cost.tracked <= sorted(counts[9:])[-1]
        used = [(u.heap_bytes, u.reach_bytes, u.stack_bytes) for u in (cost.sensing, cost.pose)]
        assert used == [sensing, pose]


@given(st.lists(numbers, max_size=9))
def test_too_few_frames_are_an_error(counts: list[int]) -> None:
    with pytest.raises(ReportError, match=f"printed {len(counts)} frames"):
        read(printed(counts, (1, 1, 1), (1, 1, 1), 1), (7, 0))


def elf(is_64: bool, sections: list[tuple[int, int, int]]) -> bytes:
    """An ELF file with these sections: type, flags, size."""
    head = bytearray(64)
    head[:6] = b"\x7fELF" + bytes([2 if is_64 else 1, 1])
    struct.pack_into("<Q" if is_64 else "<I", head, 0x28 if is_64 else 0x20, 64)
    entry = "<IIQQQQIIQQ" if is_64 else "<IIIIIIIIII"
    struct.pack_into("<HH", head, 0x3A if is_64 else 0x2E, struct.calcsize(entry), len(sections))
    rows = [struct.pack(entry, 0, kind, flags, 0, 0, size, 0, 0, 0, 0) for kind, flags, size in sections]
    return bytes(head) + b"".join(rows)


sizes = st.lists(st.integers(0, 2**20), min_size=4, max_size=4)


@given(st.booleans(), sizes)
def test_sections_are_flash_or_static_data_or_neither(is_64: bool, found: list[int]) -> None:
    code, data, zero, debug = found
    # PROGBITS 1, NOBITS 8; flags: write 1, allocated 2, code 4.
    program = elf(is_64, [(0, 0, 0), (1, 6, code), (1, 3, data), (8, 3, zero), (1, 0, debug)])
    assert section_bytes(program) == (code + data, data + zero)


@given(st.binary(max_size=200))
def test_what_is_no_program_is_an_error(garbage: bytes) -> None:
    with pytest.raises(ReportError, match="ELF"):
        section_bytes(garbage)


def test_every_table_has_a_row_for_every_chip_size_and_preset() -> None:
    text = printed(list(range(1_000_000, 1_000_016)), (2048, 4096, 1024), (2048, 4096, 1024), 5_000_000)
    firmware: Firmware = read(text, (102_407, 5))
    builds = [Build(chip, size, pose) for chip in CHIPS for size in SIZES for pose in (False, True)]
    builds += [Build(CHIPS[0], pose=pose, opt_level="s") for pose in (False, True)]
    found = dict.fromkeys(builds, firmware)
    rows = {
        write.__name__: len(write(found).splitlines()) - 2
        for write in (flash_table, memory_table, instruction_table, small_table)
    }
    assert rows == {"flash_table": 3, "memory_table": 36, "instruction_table": 36, "small_table": 2}
    # The sizes print the same text here: one row a preset.
    assert len(time_table(found).splitlines()) - 2 == 4
    assert re.search(r"fast \| 5.56 \| ", time_table(found))  # 1.00001 million at 180 MHz


@pytest.mark.long
def test_an_emulated_processor_gives_the_bits_of_this_machine() -> None:
    chip = CHIPS[0]
    if shutil.which("rustup"):
        subprocess.run(["rustup", "--quiet", "target", "add", chip.target], check=False)
    reason = missing(chip)
    if reason is not None and os.environ.get("CI") == "true":
        pytest.fail(f"CI must run the firmware: it needs {reason}")
    if reason is not None:
        pytest.skip(f"it needs {reason}")
    # The program itself fails where a digest differs, or a frame after the second one allocates.
    found = measure(EXAMPLE, Build(chip))
    assert tuple(found.presets) == PRESETS
    assert "all results have the bits of the machine that built this" in found.text
    assert found.text.count(" allocations in two frames, 0 in the next 14") == len(PRESETS)
    # The counter has steps of 40, and a few instructions surround the loop.
    executed, counted = found.loop
    assert abs(counted - executed) <= 80
