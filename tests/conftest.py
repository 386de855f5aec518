"""Settings of the property tests, and sensors that many tests look through."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from pathlib import Path

# Tests run on all processors already: threads of linear algebra that wait for each other doubled the time. It
# is read when NumPy is loaded, also by the processes that tests start.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import hypothesis
import pytest

import gelstereo

# No example may depend on how fast the machine is, and every run tries the same ones.
hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True, max_examples=60)
hypothesis.settings.load_profile("repeatable")

# Started in the background by a shell, tests ignore Ctrl-C, and so would all commands that they stop by it.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def sensor() -> gelstereo.Simulator:
    """The default sensor under a ball, with a perfect camera."""
    return gelstereo.simulate({"indenter": {"kind": "sphere", "radius_mm": 4.0}})


@pytest.fixture(scope="session")
def noisy_press() -> list[gelstereo.SimulatedFrame]:
    """A ball pressed 1.2 mm deep in five frames, with blur and noise."""
    simulator = gelstereo.simulate(
        {
            "frame_rate_hz": 5,
            "indenter": {"kind": "sphere", "radius_mm": 4.0},
            "effects": {"shoulder": {}, "defocus": {}, "sensor_noise": {}},
            "trajectory": [
                {"time_s": 0.0, "position_mm": [4.0, 0.0, 33.0]},
                {"time_s": 0.8, "position_mm": [4.0, 0.0, 31.5]},
            ],
        }
    )
    return [simulator[index] for index in range(len(simulator))]


@pytest.fixture(scope="session")
def host_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """The path of a recording by `gelstereo-host run`, and the run's own summary."""
    from test_recording_readers import host_binary

    path = tmp_path_factory.mktemp("recording") / "run.mcap"
    command = [host_binary(), "run", "--record", str(path), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return path, json.loads(done.stdout)
