"""Real gel images from other sources: detection, labels, and pictures.

Run ``python -m gelstereo_bench.reports.gels --data FOLDER`` to fill docs/real-images.md and its pictures.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo import Detector, Error, Markers, Params, RestLattice, foresight_sort, rest_lattice
from gelstereo_bench.reports.markdown import replace_between, table

__all__ = ["GELS", "Located", "RealGel", "draw", "main"]

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Located:
    """The markers of one image with their labels."""

    markers: Markers
    lattice: RestLattice

    @property
    def cut(self) -> npt.NDArray[np.bool_]:
        """Mask of markers cut by the image border; their positions are those of the visible parts."""
        apart = self.lattice.positions_px[:, None] - self.markers.cut_centres_px[None]
        return np.asarray((np.abs(apart).max(axis=2) == 0.0).any(axis=1))


@dataclass(frozen=True)
class RealGel:
    """One real image with its description."""

    name: str
    #: Path below the data folder.
    path: str
    polarity: Literal["dark", "bright"]
    channel: Literal["blue", "green", "red", "grey"]
    source: str

    def params(self, preset: str = "balanced") -> Params:
        """A preset with the image's polarity; threshold, marker size and lattice are not set."""
        return Params.preset(preset).replace(detect={"polarity": self.polarity})

    def read(self, data: Path) -> Image:
        """Read the image channel with the best marker contrast."""
        image = cv2.imread(str(data / self.path))
        if image is None:
            raise Error(f"{data / self.path} is not an image")
        if self.channel == "grey":
            return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        return np.ascontiguousarray(image[:, :, ("blue", "green", "red").index(self.channel)])

    def locate(self, data: Path, preset: str = "balanced") -> Located:
        """Detect the markers, including those cut by the border, count rows and columns, and label.

        Raises
        ------
        Error
            The markers cannot be detected or labelled; the message states why.
        """
        params = self.params(preset)
        markers = Detector(params).detect(self.read(data))
        seen_px = np.vstack([markers.centres_px, markers.cut_centres_px])
        return Located(markers, rest_lattice(seen_px, params))


GELS = (
    RealGel("9dtact-1", "9dtact_calib/s1_sample.png", "dark", "grey", "9DTact, MIT licence"),
    RealGel("9dtact-2", "9dtact_calib/s2_sample.png", "dark", "grey", "9DTact, MIT licence"),
    RealGel("khsu", "khsu_markers/pic00.jpg", "bright", "green", "gelsightmini_tracking, MIT licence"),
)


def draw(image: npt.NDArray[Any], located: Located, scale: int = 2) -> npt.NDArray[Any]:
    """Draw rows and labels over an image: whole markers green, cut ones orange, filled-in ones red."""
    lattice, cut = located.lattice, located.cut
    canvas = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    positions = (lattice.positions_px + 0.5) * scale - 0.5
    for row in positions.reshape(lattice.rows, lattice.cols, 2):
        cv2.polylines(canvas, [np.round(row).astype(np.int32)], False, (255, 80, 0), 2, cv2.LINE_AA)
    for index, position in enumerate(positions):
        x, y = (int(v) for v in np.round(position))
        colour = (0, 120, 0)
        if cut[index]:
            colour = (0, 120, 255)
        if lattice.filled[index]:
            colour = (0, 0, 255)
        cv2.circle(canvas, (x, y), 7, colour, 2, cv2.LINE_AA)
        label = f"{index // lattice.cols},{index % lattice.cols}"
        above = y - 8 if y > 30 else y + 26
        cv2.putText(canvas, label, (x + 8, above), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return np.asarray(canvas)


def main(arguments: list[str] | None = None) -> int:
    """Fill docs/real-images.md and draw its pictures."""
    parser = argparse.ArgumentParser(prog="python -m gelstereo_bench.reports.gels", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the real images")
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    options = parser.parse_args(arguments)
    rows = []
    for gel in GELS:
        print(gel.name)
        located = gel.locate(options.data)
        picture = draw(cv2.imread(str(options.data / gel.path)), located)
        cv2.imwrite(
            str(options.docs / "pictures" / f"real-{gel.name}.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, 85]
        )
        lattice = located.lattice
        whole = ~lattice.filled & ~located.cut
        seen = len(located.markers) + len(located.markers.cut_centres_px)
        rows.append(
            [
                gel.name,
                f"{gel.polarity}, {gel.channel}",
                f"{lattice.rows} x {lattice.cols}",
                *(str(int(kind.sum())) for kind in (whole, located.cut, lattice.filled)),
                str(seen - int((~lattice.filled).sum())),
                f"{lattice.pitch_px:.1f}",
                _foresight(lattice),
                *(_verdict(gel, options.data, preset) for preset in Params.presets()),
            ]
        )
    head = [
        "image",
        "markers, channel",
        "lattice counted",
        "whole",
        "cut",
        "filled in",
        "left out",
        "pitch px",
    ]
    replace_between(
        options.docs / "real-images.md",
        "gels",
        table([*head, "foresight sort", *(f"preset {p}" for p in Params.presets())], rows),
    )
    return 0


def _foresight(lattice: RestLattice) -> str:
    """Whether Algorithm 1 assigns the same labels to the complete lattice."""
    # Shuffled by a fixed stride, so that the input order cannot be the result.
    count = lattice.rows * lattice.cols
    shuffled = np.argsort(np.arange(count) * 37 % count, kind="stable")
    tolerance_px = Params().to_dict()["label"]["tolerance_pitches"] * lattice.pitch_px
    try:
        order = foresight_sort(lattice.positions_px[shuffled], lattice.rows, lattice.cols, tolerance_px)
    except Error as error:
        return f"refuses: {error}"
    wrong = int((shuffled[order] != np.arange(count)).sum())
    return "same labels" if wrong == 0 else f"{wrong} wrong labels"


def _verdict(gel: RealGel, data: Path, preset: str) -> str:
    try:
        lattice = gel.locate(data, preset).lattice
    except Error as error:
        return str(error)
    return f"{int((~lattice.filled).sum())} labelled"


if __name__ == "__main__":
    raise SystemExit(main())
