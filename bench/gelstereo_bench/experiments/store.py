"""Finished trials on disk, so that an interrupted batch can be resumed."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, TypeAlias

from gelstereo import Error

__all__ = ["Record", "Store", "StoreError"]

#: Result of a trial, JSON-compatible.
Record: TypeAlias = dict[str, Any]

_IDENTITY, _RECORDS = "batch.json", "records.jsonl"


class StoreError(Error):
    """A folder's trials cannot be used for this batch."""


class Store:
    """A folder with the finished trials of one batch: the batch's identity, and one line of JSON per trial.

    Parameters
    ----------
    folder
        Folder of the trials; created if it does not exist.
    identity
        Identity of the batch, JSON-compatible; a folder has trials of one identity only.
    resume
        Whether to use trials already in the folder.

    Raises
    ------
    StoreError
        The folder has trials and `resume` is not set; or they have another identity or are damaged; or
        another process is writing them.
    """

    def __init__(self, folder: Path, identity: Mapping[str, Any], *, resume: bool = False) -> None:
        self.folder = folder
        self._records: dict[str, Record] = {}
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / _RECORDS
        self._file = path.open("a+b")
        try:
            self._lock()
            self._check(json.loads(json.dumps(dict(identity))), resume)
            self._read(path)
        except BaseException:
            self._file.close()
            raise

    @property
    def records(self) -> Mapping[str, Record]:
        """Records of finished trials by digest."""
        return MappingProxyType(self._records)

    def add(self, digest: str, record: Record) -> None:
        """Store a trial's record and flush it to the system."""
        line = json.dumps({"trial": digest, "record": record}, allow_nan=False)
        self._file.write(line.encode() + b"\n")
        self._file.flush()
        self._records[digest] = record

    def close(self) -> None:
        """Release the folder for other processes."""
        self._file.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise StoreError(
                f"{self.folder} is in use by another batch; wait for it or name another folder"
            ) from error

    def _check(self, identity: dict[str, Any], resume: bool) -> None:
        path = self.folder / _IDENTITY
        started = (self.folder / _RECORDS).stat().st_size > 0
        if not started:
            path.write_text(json.dumps(identity, indent=1, sort_keys=True) + "\n", encoding="utf-8")
            return
        if not resume:
            raise StoreError(
                f"{self.folder} holds finished trials; --resume uses them, and another folder begins anew"
            )
        try:
            before = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise StoreError(
                f"{path} does not say of what batch the trials are ({error}); name another folder"
            ) from error
        changed = sorted(name for name in {*before, *identity} if before.get(name) != identity.get(name))
        if changed:
            said = ", ".join(
                f"another {name} ({_short(before.get(name))} then, {_short(identity.get(name))} now)"
                for name in changed
            )
            raise StoreError(
                f"the trials in {self.folder} were run with {said}; name another folder to begin anew"
            )

    def _read(self, path: Path) -> None:
        data = path.read_bytes()
        whole = data.rfind(b"\n") + 1
        for number, line in enumerate(data[:whole].splitlines(), start=1):
            try:
                entry = json.loads(line)
                self._records[entry["trial"]] = entry["record"]
            except (ValueError, KeyError, TypeError) as error:
                raise StoreError(f"{path}, line {number}, is damaged ({error}); remove that line") from error
        # A process that was killed while writing leaves half a line.
        self._file.truncate(whole)


def _short(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 20 else f"{text[:13]}..."
