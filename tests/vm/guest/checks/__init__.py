"""The checks, by topic. A check is a function that raises where something is wrong and may return figures."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Figures = dict[str, Any]


@dataclass(frozen=True)
class Check:
    """A named check."""

    name: str
    function: Callable[[], Figures | None]
    limit_s: int


CHECKS: dict[str, Check] = {}


def check(limit_s: int = 60) -> Callable[[Callable[[], Figures | None]], Callable[[], Figures | None]]:
    """Registers a function as a check that must end within `limit_s` seconds."""

    def register(function: Callable[[], Figures | None]) -> Callable[[], Figures | None]:
        CHECKS[function.__name__] = Check(function.__name__, function, limit_s)
        return function

    return register


def load_all() -> None:
    """Imports every file of checks, in the order in which they run."""
    for topic in ("stack", "uvc", "pairs", "vivid", "hid", "light", "python_cameras", "service"):
        importlib.import_module(f"guest.checks.{topic}")
