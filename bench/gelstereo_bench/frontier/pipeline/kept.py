"""Finished measurements on disk, so that an interrupted run goes on where it ended."""

from __future__ import annotations

import fcntl
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import gelstereo
from gelstereo import Error

__all__ = ["Kept", "Stage", "code_digest", "key_of"]

Stage = Literal["sensing", "locating", "budgets"]

_HERE = Path(__file__).parent
_SENSING = (
    "cases.py",
    "simulated.py",
    "traced.py",
    "sensors.py",
    "sensing.py",
    "../baseline.py",
    "../baseline_fast.py",
    "../scenes.py",
)
#: Files that measure, by stage; those that only summarise and draw leave results valid.
_MEASURING: Mapping[Stage, tuple[str, ...]] = {
    "sensing": _SENSING,
    "locating": (*_SENSING, "locators.py", "locating.py", "../registering.py", "../rivals.py"),
    "budgets": ("budgets.py", "../grasps.py", "../scenes.py"),
}


def code_digest(stage: Stage) -> str:
    """SHA-256 over the compiled package and the files that measure a stage."""
    found = hashlib.sha256()
    compiled = sorted(Path(gelstereo.__path__[0]).glob("_native*"))
    for path in (*(_HERE / name for name in _MEASURING[stage]), *compiled):
        found.update(hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()


def key_of(settings: Mapping[str, Any]) -> str:
    """SHA-256 of JSON-compatible settings: the key of their result."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


class Kept:
    """A file of results: one line of JSON for each, with its key.

    Parameters
    ----------
    path
        The file; created if it does not exist. It may hold results of other versions and settings, because
        their keys differ.

    Raises
    ------
    Error
        Another process writes the file, or a line is damaged.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self._results: dict[str, Any] = {}
        self._file = path.open("a+b")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._file.close()
            raise Error(f"{path} is in use by another run; wait for it or name another folder") from error
        self._read()

    def get(self, key: str) -> Any | None:
        """The result of a key; None if it was not measured."""
        return self._results.get(key)

    def add(self, key: str, about: Mapping[str, Any], result: Any) -> None:
        """Store a result, with what a reader of the file wants to know about it."""
        line = json.dumps({"key": key, **about, "result": result}, allow_nan=False)
        self._file.write(line.encode() + b"\n")
        self._file.flush()
        self._results[key] = json.loads(line)["result"]

    def __enter__(self) -> Kept:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def _read(self) -> None:
        data = self.path.read_bytes()
        whole = data.rfind(b"\n") + 1
        for number, line in enumerate(data[:whole].splitlines(), start=1):
            try:
                entry = json.loads(line)
                self._results[entry["key"]] = entry["result"]
            except (ValueError, KeyError, TypeError) as error:
                self._file.close()
                raise Error(f"{self.path}, line {number}, is damaged ({error}); remove the line") from error
        # A run that was killed while writing leaves half a line.
        self._file.truncate(whole)
