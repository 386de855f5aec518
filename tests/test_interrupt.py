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
from gelstereo import LayerContact, Localizer, Params, Template, geometry, localize
from gelstereo.geometry import se3_exp
signal.signal(signal.SIGINT, signal.default_int_handler)

def ball(subdivisions):
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=15.0)
    return np.array(mesh.vertices), np.array(mesh.faces)

def shell(count):
    at = np.random.default_rng(1).normal(size=(count, 3))
    normals = at / np.linalg.norm(at, axis=1)[:, None]
    return 30.0 * normals, normals

{setup}
print("ready", flush=True)
try:
    # On a fast computer one call may end before the signal comes.
    while True:
        {call}
except KeyboardInterrupt:
    print(time.monotonic(), flush=True)
{check}
print("as before", flush=True)
"""

TEMPLATE = "template = Template.from_triangles(*ball({}), spacing_mm=1.0); before = template.digest"
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
        assert child.stdout.readline() == "as before\n"
    assert child.returncode == 0
    print(f"{1000 * (float(said) - sent_s):.0f} ms")
    return float(said) - sent_s


MAKE = ("vertices, faces = ball({})", "Template.from_triangles(vertices, faces, spacing_mm=0.25)", "")
SYMMETRIES = (TEMPLATE.format(6), "template.with_symmetries(tolerance_mm=0.02)", UNCHANGED)
GRID = (TEMPLATE.format(6), "template.with_grid(cell_mm=0.05)", UNCHANGED)


PARTS = "points, normals = shell({}); "
SCAN = (PARTS.format(250_000), "Template.from_points(points, normals, 0.2)", "")
LOAD = (
    PARTS.format(20_000)
    + "import tempfile, os; path = os.path.join(tempfile.mkdtemp(), 'scan'); "
    + "template = Template.from_points(points, normals, 0.7); template.save(path); before = template.digest",
    "Template.load(path)",
    "assert Template.load(path).digest == before",
)
UNPICKLE = (
    PARTS.format(20_000)
    + "import pickle; template = Template.from_points(points, normals, 0.7); data = pickle.dumps(template)",
    "pickle.loads(data)",
    "assert pickle.loads(data).digest == template.digest",
)
CLOSEST = (
    TEMPLATE.format(6) + "; away = shell(400_000)[0]",
    "template.closest(away)",
    f"{UNCHANGED}; assert len(template.closest(away[:9]).distances_mm) == 9",
)
NEAREST = (
    TEMPLATE.format(6) + "; away = 0.1 * shell(2_000_000)[0]",
    "template.nearest(away)",
    f"{UNCHANGED}; assert len(template.nearest(away[:9])[0]) == 9",
)
POINTS = ("points, _ = shell(4_000_000)", "geometry.nearest(points[:50_000], points)", "")
TREE = ("points, _ = shell(3_000_000)", "geometry.nearest(points, points[:9])", "")
GRID_DISTANCE = (
    TEMPLATE.format(5)
    + "; template = template.with_grid(); before = template.digest; away, _ = shell(6_000_000)",
    "template.grid_distance(away)",
    UNCHANGED,
)
DENSE = (
    "from gelstereo import DenseSurface; y, x = np.mgrid[:25, :25] * 0.9; "
    "rest = np.column_stack([x.ravel(), y.ravel()])",
    "DenseSurface(rest, 0.011)",
    "",
)
LAYER = (
    "layer = LayerContact(thickness_mm=4.0, poisson_ratio=0.48, rows=256, cols=256, cell_mm=0.1, "
    "friction=0.5); y, x = np.mgrid[:256, :256] * 0.1 - 12.8; heights = 1.0 - (x * x + y * y) / 8.0; carried "
    "= np.full((256, 256, 2), 0.1); before = layer.press(heights, carried)",
    "layer.press(heights, carried, tolerance_mm=1e-13)",
    "assert np.array_equal(layer.press(heights, carried).pressure, before.pressure)",
)
# A patch of as many points as are taken, and settings with which steps go on and on.
PATCH = (
    "points, normals = shell(40_000); template = Template.from_points(points, normals, 0.6); "
    "patch = np.repeat(points[points[:, 2] < -15.0], 2, axis=0)[:{count}] + [0.2, -0.1, 0.1]; "
    "few = patch[:200]; guess = np.eye(4); params = Params().replace({settings}); "
    "usual = Params().replace(register={{'method': '{method}'}}); "
    "before = localize(few, template, guess=guess, params=usual).digest"
)
STILL_REGISTERS = "assert localize(few, template, guess=guess, params=usual).digest == before"


def registering(method: str, count: int = 20_000, **settings: dict[str, float]) -> tuple[str, str, str]:
    wide = {"register": {"method": method, **settings}}
    setup = PATCH.format(count=count, settings=wide, method=method)
    return setup, "localize(patch, template, guess=guess, params=params)", STILL_REGISTERS


SAMPLES = {
    "filterreg_point": registering(
        "filterreg_point",
        filterreg={"max_sigma_mm": 2.0},
        advanced={"max_iterations": 100_000, "step_tolerance": 1e-12},
    ),
    "ransac_icp": registering("ransac_icp", ransac_icp={"hypotheses": 1_000_000}),
    "surface_search": registering(
        "surface_search",
        2_000,
        surface_search={"starts": 4096, "budget": 100_000_000},
        advanced={"max_iterations": 100_000},
    ),
}
# The first frame is searched for, and goes on as if it had not been interrupted.
LOCALIZER = (
    PATCH.format(
        count=2_000,
        settings={
            "register": {
                "surface_search": {"starts": 4096, "budget": 100_000_000},
                "method": "surface_search",
            }
        },
        method="surface_search",
    )
    + "; localizer = Localizer(template, guess=guess, params=params)",
    "[localizer.process(patch) for _ in range(20)]",
    "assert localizer.process(few) is not None",
)
# A factorization takes seconds here, in a library that does not know of signals.
COMPLIANCE = (
    "from gelstereo.force import compute_compliance",
    "compute_compliance(rows=40, cols=40, pitch_mm=1.0, thickness_mm=4.0, rim_mm=2.0)",
    "",
)
CASES = {
    "grid": GRID,
    "symmetries": SYMMETRIES,
    "mesh": (MAKE[0].format(7), *MAKE[1:]),
    "scan": SCAN,
    "load": LOAD,
    "unpickle": UNPICKLE,
    "closest": CLOSEST,
    "nearest": NEAREST,
    "points": POINTS,
    "tree": TREE,
    "grid_distance": GRID_DISTANCE,
    "dense": DENSE,
    "layer": LAYER,
    "compliance": COMPLIANCE,
    "localizer": LOCALIZER,
    **SAMPLES,
}


@pytest.mark.realtime
@pytest.mark.parametrize("delay_s", [0.1, pytest.param(0.4, marks=pytest.mark.long)])
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_row_38_ctrl_c_ends_long_work(case: tuple[str, str, str], delay_s: float) -> None:
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
