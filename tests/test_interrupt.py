"""Ctrl-C ends long work of the core soon, and leaves what there is as it was."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

LATENCY_S = 0.3

# The child's clock is the parent's: CLOCK_MONOTONIC counts from the same start in all processes.
CHILD = """
import signal, sys, threading, time
import numpy as np
import trimesh
from gelstereo import Template
signal.signal(signal.SIGINT, signal.default_int_handler)

def ball(subdivisions):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=15.0)
    return np.array(mesh.vertices), np.array(mesh.faces)

{setup}
print("ready", flush=True)
try:
    {call}
    print("finished", flush=True)
except KeyboardInterrupt:
    print(time.monotonic(), flush=True)
{check}
print("as before", flush=True)
"""

TEMPLATE = "template = Template.from_triangles(*ball({}), spacing_mm=0.25); before = template.digest"
UNCHANGED = "assert template.digest == before"


def latency_s(setup: str, call: str, check: str, delay_s: float) -> float:
    """From SIGINT, sent so long after the call began, to KeyboardInterrupt."""
    code = CHILD.format(setup=setup, call=call, check=check)
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        time.sleep(delay_s)
        sent_s = time.monotonic()
        child.send_signal(signal.SIGINT)
        said = child.stdout.readline().strip()
        assert said != "finished", "the call ended before it was interrupted"
        assert child.stdout.readline() == "as before\n"
    assert child.returncode == 0
    print(f"{1000 * (float(said) - sent_s):.0f} ms")
    return float(said) - sent_s


MAKE = ("vertices, faces = ball({})", "Template.from_triangles(vertices, faces, spacing_mm=0.25)", "")
SYMMETRIES = (TEMPLATE.format(6), "template.with_symmetries(tolerance_mm=0.02)", UNCHANGED)
GRID = (TEMPLATE.format(6), "template.with_grid(cell_mm=0.05)", UNCHANGED)


@pytest.mark.realtime
@pytest.mark.parametrize("delay_s", [0.1, 0.4])
@pytest.mark.parametrize(
    "case", [GRID, SYMMETRIES, (MAKE[0].format(7), *MAKE[1:])], ids=["grid", "symmetries", "mesh"]
)
def test_ctrl_c_ends_long_work(case: tuple[str, str, str], delay_s: float) -> None:
    assert latency_s(*case, delay_s) < LATENCY_S


@pytest.mark.long
@pytest.mark.parametrize("delay_s", [0.2, 0.6, 1.0, 1.4, 2.0, 3.0, 5.0])
def test_ctrl_c_ends_a_large_mesh(delay_s: float) -> None:
    assert latency_s(MAKE[0].format(8), *MAKE[1:], delay_s) < LATENCY_S


@pytest.mark.realtime
def test_ctrl_c_reaches_the_main_thread_while_another_works() -> None:
    setup = TEMPLATE.format(5) + (
        "; made = []; thread = threading.Thread(target=lambda: made.append(template.with_grid(cell_mm=0.05)))"
    )
    check = f"thread.join(); assert len(made) == 1; {UNCHANGED}"
    assert latency_s(setup, "thread.start(); time.sleep(60.0)", check, 0.2) < LATENCY_S
