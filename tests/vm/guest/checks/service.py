"""The host as it is operated: its doctor, and the packaged unit under systemd, with the camera behind
uvcvideo.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from guest.checks import Figures, check
from guest.devices import OUT, camera
from guest.programs import path
from guest.usb.camera import plugged

REPOSITORY = Path(__file__).resolve().parents[4]
UNIT = "gelstereo-sense.service"
HEALTH = Path("/run/gelstereo/health.json")
CONFIGURATION = """
preset = "fast"
rig_file = "rig.toml"
source = { kind = "camera", device = "serial:GS0003", size_px = [1280, 480], frame_rate_hz = 4.0 }
sense = { localize = "never", rest_frames = 3 }
part = { spacing_mm = 1.0 }
# Slow enough for 4 Hz: the doctor says whether a task would start.
task = { closing_speed_mm_s = 5.0, insertion_speed_mm_s = 5.0, move_speed_mm_s = 200.0 }
"""
# systemd as the first process of a namespace of its own: the guest's first process is busybox. Kernel file
# systems and devices are the guest's; of control groups it gets a tree of its own.
CONTAINER = f"""
mount -t tmpfs tmpfs /run && mkdir -p /run/systemd /run/lock
mount -t cgroup2 cgroup2 /sys/fs/cgroup
export container=guest SYSTEMD_LOG_TARGET=console
exec /lib/systemd/systemd --system --unit={UNIT} --show-status=no
"""


def install() -> None:
    """What docs/sensing.md tells the operator to do; udev's groups are set by hand, since no udev
    runs here.
    """
    if Path("/etc/gelstereo").exists():
        return
    shutil.copy(path("gelstereo-host"), "/usr/local/bin/gelstereo-host")
    shutil.copy(REPOSITORY / "packaging" / UNIT, "/etc/systemd/system")
    # The namespace has no other unit to wait for: what sysinit.target would do, the guest's first process has
    # done.
    drop_in = Path(f"/etc/systemd/system/{UNIT}.d/guest.conf")
    drop_in.parent.mkdir(parents=True)
    drop_in.write_text("[Unit]\nDefaultDependencies=no\n", encoding="utf-8")
    with Path("/etc/passwd").open("a", encoding="utf-8") as users:
        users.write("gelstereo:x:990:990::/nonexistent:/usr/sbin/nologin\n")
    with Path("/etc/group").open("a", encoding="utf-8") as groups:
        groups.write("gelstereo:x:990:\n")
    folder = Path("/etc/gelstereo")
    folder.mkdir()
    (folder / "cell.toml").write_text(CONFIGURATION, encoding="utf-8")
    shutil.copy(OUT / "frames" / "rig.toml", folder / "rig.toml")


def diagnosis(user: int = 0) -> tuple[int, dict[str, dict[str, str]]]:
    """Exit code of the doctor, run by this user, and its findings by subject."""
    command = [path("gelstereo-host"), "doctor", "--config", "/etc/gelstereo/cell.toml", "--json"]
    groups: dict[str, Any] = {"user": user, "group": user, "extra_groups": []} if user else {}
    done = subprocess.run(
        command, cwd="/tmp", capture_output=True, text=True, timeout=120, check=False, **groups
    )
    assert done.returncode in (0, 1), done.stderr
    return done.returncode, {finding["subject"]: finding for finding in json.loads(done.stdout)["findings"]}


@check(limit_s=120)
def the_doctor_finds_the_camera_measures_it_and_says_who_may_use_it() -> Figures:
    install()
    code, findings = diagnosis()
    assert code == 1 and findings["camera"]["level"] == "wrong", findings
    device = camera("GS0003", kind="gel")
    with plugged(device):
        code, findings = diagnosis()
        measured = findings["capture"]
        assert code == 0 and measured["level"] != "wrong" and "of 4.0 Hz" in measured["found"], findings
        code, strangers = diagnosis(user=65534)
        assert code == 1, strangers
        advice = [found["advice"] for found in strangers.values() if "advice" in found]
        assert any("video" in text for text in advice), strangers
    return {"capture": measured["found"], "to a stranger": advice}


class System:
    """systemd in a namespace of its own."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process

    def run(self, *command: str) -> subprocess.CompletedProcess[str]:
        """A command beside the service."""
        (child,) = Path(f"/proc/{self._process.pid}/task/{self._process.pid}/children").read_text().split()
        inside = ["nsenter", "--target", child, "--pid", "--mount", "--root", *command]
        return subprocess.run(inside, capture_output=True, text=True, timeout=60, check=False)

    def show(self, name: str) -> str:
        """A property of the unit."""
        return self.run("systemctl", "show", "--value", f"--property={name}", UNIT).stdout.strip()

    def health(self) -> tuple[int, str]:
        """What `gelstereo-host health` says."""
        done = self.run("/usr/local/bin/gelstereo-host", "health", str(HEALTH), "--max-age-s", "30")
        return done.returncode, (done.stdout + done.stderr).strip()

    def wait(self, condition: Callable[[], bool], what: str, limit_s: float = 90.0) -> float:
        """Waits for a condition; returns how long that took."""
        start = time.monotonic()
        while not condition():
            if time.monotonic() - start > limit_s:
                log = self.run("systemctl", "status", "--no-pager", "--full", UNIT).stdout
                raise AssertionError(f"no {what} within {limit_s:.0f} s: {self.health()}\n{log}")
            time.sleep(0.5)
        return time.monotonic() - start


@contextmanager
def systemd() -> Iterator[System]:
    """A running systemd whose one unit is ours."""
    command = ["busybox", "unshare", "-f", "-p", "-m", "--mount-proc", "sh", "-c", CONTAINER]
    with (OUT / "systemd.txt").open("wb") as log:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
    try:
        yield System(process)
    finally:
        subprocess.run(["pkill", "-KILL", "-P", str(process.pid)], check=False)
        process.wait(20)


def newest_pid(system: System) -> int:
    """The service's process, by the namespace's own numbers."""
    return int(system.show("MainPID") or 0)


@check(limit_s=300)
def the_unit_senses_survives_a_hang_and_reports_its_health() -> Figures:
    install()
    device = camera("GS0003", kind="gel")
    with plugged(device), systemd() as system:
        for node in device.nodes("video4linux"):
            shutil.chown(node, group="video")
            os.chmod(node, 0o660)
        figures: dict[str, Any] = {}
        active = lambda: system.show("ActiveState") == "active"  # noqa: E731
        figures["active_s"] = system.wait(active, "active unit")
        figures["healthy_s"] = system.wait(lambda: system.health()[0] == 0, "health")
        contact = lambda: ", contact" in system.show("StatusText")  # noqa: E731
        figures["contact_s"] = system.wait(contact, "contact")
        figures["status"] = system.show("StatusText")

        # A loop that hangs is found by systemd's watchdog, and sensing begins anew.
        hung = newest_pid(system)
        system.run("kill", "-STOP", str(hung))

        def is_sensing_again() -> bool:
            return newest_pid(system) not in (0, hung) and active() and system.health()[0] == 0

        figures["after_hang_s"] = system.wait(is_sensing_again, "restart after a hang")
        assert system.show("NRestarts") == "1", system.show("NRestarts")

        # Ctrl-C's way: the recording is closed.
        stopped = system.run("systemctl", "stop", UNIT)
        assert stopped.returncode == 0, stopped.stderr
        assert system.show("Result") == "success", system.show("Result")
        recordings = sorted(Path("/var/lib/gelstereo").glob("*.mcap"))
        assert len(recordings) == 2, recordings
        replayed = system.run("/usr/local/bin/gelstereo-host", "replay", str(recordings[-1]))
        assert replayed.returncode == 0 and "same bits" in replayed.stdout, replayed.stdout + replayed.stderr
    return figures
