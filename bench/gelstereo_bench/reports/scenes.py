"""The gallery of scenes: a picture, the plan and a digest of each.

Run ``python -m gelstereo_bench.reports.scenes`` in the repository to fill docs/scenes.md and its pictures;
``--check`` lists changed digests and writes nothing.
"""

from __future__ import annotations

import argparse
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from gelstereo import Scene, SimulatedFrame, Simulator, simulate
from gelstereo.view.canvas import FAINT, INK, Canvas
from gelstereo.view.picture import indentation_colours
from gelstereo_bench.reports.markdown import replace_between, table

__all__ = ["Exhibit", "digest", "draw", "main", "moments"]

#: Moments shown, as fractions of the sequence from the first frame to the last.
SHARES = (0.3, 0.6, 0.95)
_WIDTH, _GAP, _HEAD = 384, 12, 30


@dataclass(frozen=True)
class Exhibit:
    """A loaded and planned scene file."""

    name: str
    simulator: Simulator
    #: The comment at the head of the file.
    text: str

    @classmethod
    def open(cls, path: Path) -> Exhibit:
        """Load and plan a scene file."""
        lines = path.read_text(encoding="utf-8").splitlines()
        head = [line.lstrip("# ") for line in lines[: next(i for i, x in enumerate(lines) if x[:1] != "#")]]
        return cls(path.stem, simulate(Scene.load(path)), " ".join(head))


def moments(simulator: Simulator) -> list[SimulatedFrame]:
    """Three frames from early to late."""
    last = len(simulator) - 1
    return [simulator[int(share * last)] for share in SHARES]


def digest(frames: Sequence[SimulatedFrame]) -> str:
    """CRC-32 of the frames' images, left before right, in hexadecimal."""
    value = 0
    for frame in frames:
        for image in (frame.left, frame.right):
            value = zlib.crc32(image.tobytes(), value)
    return f"{value:08x}"


def draw(exhibit: Exhibit, frames: Sequence[SimulatedFrame]) -> npt.NDArray[np.uint8]:
    """Draw the left images of some frames and, below, the markers' lateral motion and height."""
    height, width = frames[0].left.shape
    tall = round(_WIDTH * height / width)
    canvas = Canvas(len(frames) * (_WIDTH + _GAP) + _GAP, _HEAD + 2 * (tall + _GAP) + 24)
    canvas.text(exhibit.name, _GAP, 21, 15.0, INK, bold=True)
    rest = exhibit.simulator.press()
    for column, frame in enumerate(frames):
        x = _GAP + column * (_WIDTH + _GAP)
        canvas.image(frame.left, x, _HEAD, _WIDTH, tall)
        _draw_motion(canvas, rest, frame, (x, _HEAD + tall + _GAP), _WIDTH / width)
        note = f"{frame.time_s:.2f} s, up to {1e3 * np.max(frame.indentation_mm):.0f} um high"
        canvas.text(note, x, _HEAD + 2 * tall + _GAP + 20, 12.0, FAINT)
    return canvas.finished()


def _draw_motion(
    canvas: Canvas, rest: SimulatedFrame, frame: SimulatedFrame, at: tuple[int, int], scale: float
) -> None:
    colours, _ = indentation_colours(np.asarray(frame.indentation_mm))
    seen = [(p + 0.5) * scale - 0.5 + at for p in (np.asarray(rest.left_px), np.asarray(frame.left_px))]
    tall = _WIDTH / frame.left.shape[1] * frame.left.shape[0]
    inside = np.all((seen[1] > at) & (seen[1] < (at[0] + _WIDTH, at[1] + tall)), axis=1)
    dense = len(colours) > 2000
    for start, end, colour, shown in zip(*seen, colours, inside, strict=True):
        if shown:
            tint = (int(colour[0]), int(colour[1]), int(colour[2]))
            canvas.circle(end, 1.5 if dense else 3.0, tint, 1.5)
            if not dense:
                canvas.arrow(start, end, INK)


def _section(exhibit: Exhibit) -> str:
    plan = exhibit.simulator.plan
    on = ", ".join(effect.name for effect in plan.effects if effect.on)
    off = ", ".join(effect.name for effect in plan.effects if not effect.on)
    lines = [
        f"## {exhibit.name}",
        "",
        exhibit.text,
        "",
        f"![{exhibit.name}](pictures/scene-{exhibit.name}.jpg)",
        "",
    ]
    lines.append(f"Computed: {on or 'nothing but the imprint'}." + (f" Off: {off}." if off else ""))
    return "\n".join(lines)


def _rows(exhibits: Sequence[Exhibit]) -> list[list[str]]:
    def row(exhibit: Exhibit) -> list[str]:
        plan = exhibit.simulator.plan
        on = sum(effect.on for effect in plan.effects)
        count = f"{on} of {len(plan.effects)}"
        link = f"[{exhibit.name}](../scenes/{exhibit.name}.toml)"
        return [link, str(len(exhibit.simulator)), count, f"`{digest(moments(exhibit.simulator))}`"]

    return [row(exhibit) for exhibit in exhibits]


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the page and its pictures; the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", type=Path, default=Path("scenes"), help="folder of scene files")
    parser.add_argument("--page", type=Path, default=Path("docs/scenes.md"), help="page to fill")
    parser.add_argument("--check", action="store_true", help="compare digests with the page's, write nothing")
    options = parser.parse_args(arguments)
    exhibits = [Exhibit.open(path) for path in sorted(options.scenes.glob("*.toml"))]
    rows = _rows(exhibits)
    if options.check:
        page = options.page.read_text(encoding="utf-8")
        moved = [row for row in rows if row[0] not in page or row[-1] not in page]
        for row in moved:
            print(f"{row[0]} is now {row[-1]}")
        return 1 if moved else 0
    import cv2

    for exhibit in exhibits:
        path = options.page.parent / "pictures" / f"scene-{exhibit.name}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        picture = draw(exhibit, moments(exhibit.simulator))
        if not cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, 72]):
            raise OSError(f"{path} could not be written")
    head = ["scene", "frames", "effects computed", "digest"]
    replace_between(options.page, "gallery", table(head, rows))
    replace_between(options.page, "exhibits", "\n\n".join(map(_section, exhibits)))
    print(f"wrote {options.page} and {len(exhibits)} pictures")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
