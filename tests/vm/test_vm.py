"""The host's drivers against the kernel's own stacks, in one throw-away VM; each check in it is one test here."""

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
import pytest
from guest.checks import CHECKS, load_all

REPOSITORY = Path(__file__).resolve().parents[2]
PROGRAMS = ["camera_probe", "hid_probe"]

pytestmark = pytest.mark.long
load_all()


def write_frames(folder: Path) -> None:
    """Pictures as a camera would send them: dots that move, and noise, so that no two files are alike."""
    folder.mkdir(parents=True)
    generator = np.random.default_rng(20211)
    for number in range(12):
        views = []
        for shift_px in (0, 14):
            view = generator.normal(60.0, 4.0, (480, 640)).clip(0, 255).astype(np.uint8)
            for y in range(60, 440, 40):
                for x in range(80, 600, 40):
                    cv2.circle(view, (x + shift_px + number, y), 7, 220, -1, cv2.LINE_AA)
            views.append(view)
        for name, picture in (("stereo", np.hstack(views)), ("left", views[0]), ("right", views[1])):
            # A camera's JPEG is in colour.
            cv2.imwrite(str(folder / f"{name}_{number:02}.jpg"), cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))


def build_programs(out: Path) -> None:
    """Builds what the checks run, and tells the guest where it is."""
    command = ["cargo", "build", "--quiet", "--release", "-p", "gelstereo-host"]
    command += [part for name in PROGRAMS for part in ("--example", name)]
    subprocess.run(command, cwd=REPOSITORY, check=True)
    target = Path(os.environ.get("CARGO_TARGET_DIR", REPOSITORY / "target")) / "release"
    programs = {name: str(target / "examples" / name) for name in PROGRAMS}
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
    lines = (
        (out / "results.jsonl").read_text(encoding="utf-8").splitlines()
        if (out / "results.jsonl").exists()
        else []
    )
    found = {line["check"]: line for line in map(json.loads, lines)}
    print(f"VM: boot {outcome.boot_s:.1f} s, in all {outcome.total_s:.1f} s", *found.values(), sep="\n")
    return {"console": {"error": outcome.console[-4000:]}, **found}


@pytest.mark.parametrize("name", CHECKS)
def test_in_the_vm(name: str, results: dict[str, dict[str, Any]]) -> None:
    result = results.get(name)
    assert result is not None, f"the VM ended before this check; its console:\n{results['console']['error']}"
    assert result["error"] is None, result["error"]
