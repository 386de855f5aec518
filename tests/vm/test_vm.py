"""The host's drivers against the kernel's own stacks, in one throw-away VM; each check in it is one test
here.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import image
import machine
import numpy as np
import numpy.typing as npt
import pytest
from guest.checks import CHECKS, load_all

import gelstereo as gs

REPOSITORY = Path(__file__).resolve().parents[2]
EXAMPLES = ["camera_probe", "hid_probe"]

pytestmark = [pytest.mark.long, pytest.mark.realtime]
load_all()


def write_frames(folder: Path) -> None:
    """Pictures as a camera would send them, in the sizes of `guest.devices`: no two files are alike."""
    folder.mkdir(parents=True)
    generator = np.random.default_rng(20211)
    for number in range(12):
        left, right = (view(320, 240, 10 * side + number, generator) for side in range(2))
        for name, picture in (("stereo", np.hstack([left, right])), ("left", left), ("right", right)):
            write_jpeg(folder / f"{name}_{number:02}.jpg", picture)
    for number in range(3):
        views = [view(1280, 720, 20 * side + number, generator) for side in range(2)]
        write_jpeg(folder / f"large_{number:02}.jpg", np.hstack(views))
    write_gel(folder)


def write_gel(folder: Path) -> None:
    """The simulated sensor at rest and under a ball, at 4 Hz, and the rig that sees it."""
    scene = gs.Scene.load(REPOSITORY / "scenes" / "press_sphere.toml")
    frames = gs.simulate(scene)
    for number, index in enumerate([*range(6), *range(6), *range(8, len(frames) - 5, 6)]):
        frame = frames[index]
        write_jpeg(folder / f"gel_{number:02}.jpg", np.hstack([frame.left, frame.right]))
    (folder / "rig.toml").write_text(scene.rig.to_toml(), encoding="utf-8")


def view(width: int, height: int, shift_px: int, generator: np.random.Generator) -> npt.NDArray[np.uint8]:
    """A lattice of dots in noise."""
    image = generator.normal(60.0, 4.0, (height, width)).clip(0, 255).astype(np.uint8)
    for y in range(20, height, 25):
        for x in range(20, width, 25):
            cv2.circle(image, (x + shift_px, y), 5, 220, -1, cv2.LINE_AA)
    return image


def write_jpeg(path: Path, gray: npt.NDArray[np.uint8]) -> None:
    """A camera's JPEG is in colour."""
    cv2.imwrite(str(path), cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), [cv2.IMWRITE_JPEG_QUALITY, 80])


def build_programs(out: Path) -> None:
    """Builds what the checks run, and tells the guest where it is."""
    command = ["cargo", "build", "--quiet", "--release", "-p", "gelstereo-host"]
    command += ["--bin", "gelstereo-host", *(part for name in EXAMPLES for part in ("--example", name))]
    subprocess.run(command, cwd=REPOSITORY, check=True)
    target = Path(os.environ.get("CARGO_TARGET_DIR", REPOSITORY / "target")) / "release"
    programs = {name: str(target / "examples" / name) for name in EXAMPLES}
    programs["gelstereo-host"] = str(target / "gelstereo-host")
    (out / "programs.json").write_text(json.dumps(programs), encoding="utf-8")


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """What every check in the VM gave."""
    cache = REPOSITORY / "target" / "vm"
    try:
        booted = image.build(cache)
    except image.Unavailable as reason:
        if os.environ.get("CI") == "true":
            pytest.fail(f"CI must run the device tests: {reason}")
        pytest.skip(f"no VM for the device tests: {reason}")
    out = tmp_path_factory.mktemp("vm")
    write_frames(out / "frames")
    build_programs(out)
    names = " ".join(os.environ.get("GELSTEREO_VM_CHECKS", "").split())
    script = f"exec '{sys.executable}' '{Path(__file__).parent / 'guest' / 'main.py'}' {names}\n"
    outcome = machine.run(booted, script, out)
    kept = out / "results.jsonl"
    lines = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
    found = {line["check"]: line for line in map(json.loads, lines)}
    summary = {"boot_s": outcome.boot_s, "total_s": outcome.total_s, "checks": list(found.values())}
    (cache / "results.json").write_text(json.dumps(summary, indent=1), encoding="utf-8")
    return {"console": {"error": outcome.console[-4000:]}, **found}


@pytest.mark.parametrize("name", CHECKS)
def test_in_the_vm(name: str, results: dict[str, dict[str, Any]]) -> None:
    result = results.get(name)
    assert result is not None, f"the VM ended before this check; its console:\n{results['console']['error']}"
    assert result["error"] is None, result["error"]
