"""The host's programs, run as a user runs them; their lines of JSON are what the checks look at."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Line = dict[str, Any]


def path(program: str) -> str:
    """Where the host built a program."""
    found: dict[str, str] = json.loads(Path("/out/programs.json").read_text(encoding="utf-8"))
    return found[program]


@dataclass
class Run:
    """A program that was started, and what it has said until now."""

    process: subprocess.Popen[str]
    lines: list[Line] = field(default_factory=list)
    times_s: list[float] = field(default_factory=list)
    """When each line came, by ``time.monotonic``."""

    def of(self, kind: str) -> list[Line]:
        """Lines whose ``line`` is this."""
        return [line for line in list(self.lines) if line.get("line") == kind]

    def end_input(self) -> None:
        """Closes the program's standard input."""
        assert self.process.stdin is not None
        self.process.stdin.close()

    def wait_for(self, condition: Callable[[Run], bool], what: str, limit_s: float = 30.0) -> None:
        """Waits until what the program has said fulfils a condition."""
        end = time.monotonic() + limit_s
        while not condition(self):
            if time.monotonic() > end or (self.process.poll() is not None and not condition(self)):
                raise AssertionError(f"no {what} within {limit_s:.0f} s; last lines: {self.lines[-5:]}")
            time.sleep(0.02)


def ended(program: str, *arguments: str, limit_s: float = 60.0) -> tuple[int, list[Line], str]:
    """Exit code, lines and errors of a program that ends by itself."""
    command = [path(program), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=limit_s, check=False)
    return done.returncode, [json.loads(line) for line in done.stdout.splitlines()], done.stderr.strip()


def answers(program: str, *arguments: str) -> list[Line]:
    """Lines of a program that must succeed."""
    code, lines, errors = ended(program, *arguments)
    assert code == 0, (code, errors, lines)
    return lines


def python_answers(code: str) -> list[Any]:
    """What Python code said by ``say(...)``. It runs in a process of its own: hidapi holds Python's lock
    while it waits for a device, and the device of a check is Python too.
    """
    head = "import json, gelstereo.hid\ndef say(*values): print(json.dumps(values))\n"
    command = [sys.executable, "-c", head + textwrap.dedent(code)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=90, check=False)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


@contextmanager
def running(program: str, *arguments: str, interactive: bool = False) -> Iterator[Run]:
    """A program that runs beside the check and is ended with it; an interactive one has a standard input."""
    command = [path(program), *arguments]
    given = subprocess.PIPE if interactive else subprocess.DEVNULL
    process = subprocess.Popen(
        command, stdin=given, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    run = Run(process)

    def collect() -> None:
        assert process.stdout is not None
        for line in process.stdout:
            # What is no JSON is an error message.
            run.lines.append(json.loads(line) if line.startswith("{") else {"line": "error", "text": line})
            run.times_s.append(time.monotonic())

    thread = threading.Thread(target=collect, daemon=True)
    thread.start()
    try:
        yield run
    finally:
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
        thread.join(10)
