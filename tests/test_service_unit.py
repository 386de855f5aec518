"""The unit for systemd is valid, and its command line is one that the host takes."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from test_recording_readers import host_binary

UNIT = Path(__file__).parents[1] / "packaging" / "gelstereo-sense.service"


def test_systemd_accepts_the_unit(tmp_path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    # It looks for the program, which is installed only where the service runs.
    unit = tmp_path / UNIT.name
    unit.write_text(UNIT.read_text().replace("ExecStart=gelstereo-host", "ExecStart=/bin/true"))
    done = subprocess.run(
        ["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_host_takes_the_units_command_line(tmp_path) -> None:
    text = UNIT.read_text().replace("\\\n", " ")
    found = re.search(r"^ExecStart=\S+ (.*)$", text, re.MULTILINE)
    assert found
    # Its folders are not here: all that may be wrong is the configuration's path.
    command = [host_binary(), *found.group(1).replace("/etc/gelstereo", str(tmp_path)).split()]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2 and f"cannot read {tmp_path}/cell.toml" in done.stderr, done.stderr
