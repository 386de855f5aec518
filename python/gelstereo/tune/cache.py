"""Measurements kept between runs: of one machine, image size, print, version and input."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gelstereo._native import Error

__all__ = ["Conditions", "StaleCache", "Store", "default_folder", "file_name", "processor"]


class StaleCache(Error):
    """Kept measurements were made under other conditions."""


@dataclass(frozen=True)
class Conditions:
    """What measurements depend on.

    Attributes
    ----------
    processor, cores, image_size, markers, version : str
        Such as ``"640x480"`` and ``"25x25"``; the version is that of gelstereo.
    sensor, frames, part : str
        Digests of the rig and settings, of the scene or recording, and of the part with its tolerance and
        guesses.
    """

    processor: str
    cores: str
    image_size: str
    markers: str
    version: str
    sensor: str
    frames: str
    part: str

    def differences(self, other: Mapping[str, str]) -> list[str]:
        """What differs in other conditions, in words."""
        return [
            f"{name.replace('_', ' ')} {_short(other.get(name, 'none'))} instead of {_short(value)}"
            for name, value in asdict(self).items()
            if other.get(name) != value
        ]


class Store:
    """Values by name in one file, written after each measurement.

    Parameters
    ----------
    path
        File; None keeps nothing.
    conditions
        Of the new measurements.
    measure_again
        Whether to drop what is there.

    Raises
    ------
    StaleCache
        The file is of other conditions, or cannot be read.
    """

    def __init__(self, path: Path | None, conditions: Conditions, *, measure_again: bool = False) -> None:
        self.path = path
        self._conditions = conditions
        self.values: dict[str, Any] = {}
        if path is not None and path.exists() and not measure_again:
            self.values = self._read(path)

    def _read(self, path: Path) -> dict[str, Any]:
        remedy = "measure again with --measure-again, or choose another folder with --cache"
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
            conditions, values = dict(kept["conditions"]), dict(kept["values"])
        except (ValueError, KeyError, TypeError) as error:
            raise StaleCache(f"{path} has no measurements of gelstereo; {remedy}") from error
        found = self._conditions.differences(conditions)
        if found:
            raise StaleCache(f"the measurements in {path} are stale: {', '.join(found)}; {remedy}")
        return values

    def keep(self, values: Mapping[str, Any]) -> None:
        """Add values, and write the file: whole, or not at all."""
        self.values |= values
        if self.path is None:
            return
        self.path.parent.mkdir(parents=True, exist_ok=True)
        draft = self.path.with_suffix(".part")
        kept = {"conditions": asdict(self._conditions), "values": self.values}
        draft.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
        os.replace(draft, self.path)


def default_folder() -> Path:
    """The user's folder for what can be made again (XDG base directory specification 0.8)."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gelstereo" / "tune"


def file_name(source: Path, part: str, conditions: Conditions) -> str:
    """Name of the file for a scene or recording and a part: the same while machine, images and print are."""
    place = [str(source.resolve()), part, conditions.processor, conditions.cores]
    place += [conditions.image_size, conditions.markers]
    digest = hashlib.sha256("\n".join(place).encode()).hexdigest()
    return f"{source.stem}-{conditions.image_size}-{conditions.markers}-{digest[:8]}.json"


def processor() -> str:
    """Name of the processor."""
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass  # not Linux
    return platform.processor() or platform.machine()


def _short(value: str) -> str:
    """A digest by its first digits."""
    return value[:8] if len(value) == 64 and " " not in value else value
