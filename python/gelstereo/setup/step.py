"""Results of the steps of a setup, stored so that a setup can be resumed."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

__all__ = ["Figure", "Step", "digest_of", "load_step", "save_step"]


@dataclass(frozen=True)
class Figure:
    """A measured figure of a step, as text with its unit, and what is usual or valid."""

    name: str
    value: str
    usual: str = ""


@dataclass(frozen=True)
class Step:
    """Result of a step.

    Attributes
    ----------
    name, title
        Short name, and heading of the report.
    figures
        Figures of merit.
    doubts
        Why the result may be wrong, and what to do; empty if it is good.
    advice
        What would make the result better.
    values
        What later steps and the sensor file use.
    picture
        PNG, or ``None``.
    caption
        Description of the picture.
    """

    name: str
    title: str
    figures: tuple[Figure, ...] = ()
    doubts: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict)
    picture: bytes | None = None
    caption: str = ""

    @property
    def is_good(self) -> bool:
        """Whether nothing is in doubt."""
        return not self.doubts

    def __str__(self) -> str:
        verdict = "good" if self.is_good else "doubtful"
        lines = [f"{self.title}: {verdict}"]
        for figure in self.figures:
            usual = f"   ({figure.usual})" if figure.usual else ""
            lines.append(f"    {figure.name:<34} {figure.value}{usual}")
        lines += [f"    doubt: {doubt}" for doubt in self.doubts]
        lines += [f"    better: {advice}" for advice in self.advice]
        return "\n".join(lines)


def digest_of(version: str, files: Iterable[Path], *settings: object) -> str:
    """Digest of the program's version, of files' contents and of settings."""
    digest = hashlib.sha256(repr((version, settings)).encode())
    for path in files:
        digest.update(f"\n{path.name} ".encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def load_step(path: Path, digest: str) -> Step | None:
    """A stored step, unless it is missing, unreadable or from other inputs."""
    try:
        tree = json.loads(path.read_text(encoding="utf-8"))
        if tree.pop("digest") != digest:
            return None
        picture = tree.pop("picture")
        figures = tuple(Figure(**figure) for figure in tree.pop("figures"))
        doubts, advice = tuple(tree.pop("doubts")), tuple(tree.pop("advice"))
        decoded = None if picture is None else base64.b64decode(picture)
        return Step(**tree, figures=figures, doubts=doubts, advice=advice, picture=decoded)
    except (OSError, ValueError, KeyError, TypeError):
        # It is made anew.
        return None


def save_step(path: Path, step: Step, digest: str) -> None:
    """Store a step; an interruption leaves the old file or none."""
    picture = None if step.picture is None else base64.b64encode(step.picture).decode("ascii")
    tree = {**asdict(step), "values": dict(step.values), "picture": picture, "digest": digest}
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    unfinished.write_text(json.dumps(tree), encoding="utf-8")
    unfinished.replace(path)
