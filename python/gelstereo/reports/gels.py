"""Real gel images that nobody on this project took: detected, labelled, drawn.

Run ``python -m gelstereo.reports.gels --data FOLDER`` to fill docs/real-images.md and its pictures.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from gelstereo import Detector, Error, Params, RestLattice, foresight_sort, rest_lattice
from gelstereo.reports.markdown import replace_between, table

__all__ = ["GELS", "RealGel", "draw", "main"]

Image = npt.NDArray[np.uint8]
Channel = Literal["blue", "green", "red", "grey"]

_TACT: Mapping[str, Any] = {
    "centre": "grey",
    "smooth_kernel_px": 15,
    "background_kernel_px": 101,
    "threshold_levels": 4,
    "min_area_px2": 40,
    "max_area_px2": 3000,
}
_KHSU: Mapping[str, Any] = {
    "polarity": "bright",
    "centre": "grey",
    "smooth_kernel_px": 5,
    "background_kernel_px": 81,
    "threshold_levels": 12,
    "min_area_px2": 40,
    "max_area_px2": 2500,
    "min_fill": 0.4,
}


@dataclass(frozen=True)
class RealGel:
    """One real image and the settings that suit it."""

    name: str
    #: Below the data folder.
    path: str
    rows: int
    cols: int
    #: Markers that the border cuts off, or that the print lacks.
    max_missing: int
    channel: Channel
    detect: Mapping[str, Any] = field(default_factory=dict)
    source: str = ""

    def params(self, preset: str | None = None) -> Params:
        """Give the settings that suit the image, or a preset with the image's lattice."""
        lattice = {
            "rows": self.rows,
            "cols": self.cols,
            "max_missing_share": self.max_missing / (self.rows * self.cols),
        }
        if preset is not None:
            return Params.preset(preset).replace({"lattice": lattice})
        return Params().replace({"lattice": lattice, "detect": dict(self.detect)})

    def read(self, data: Path) -> Image:
        """Read the channel of the image in which the markers show best."""
        image = cv2.imread(str(data / self.path))
        if image is None:
            raise Error(f"{data / self.path} is not an image")
        if self.channel == "grey":
            return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        return np.ascontiguousarray(image[:, :, ("blue", "green", "red").index(self.channel)])

    def locate(self, data: Path, preset: str | None = None) -> RestLattice:
        """Detect and label the markers.

        Raises
        ------
        Error
            The markers cannot be detected or labelled; it says why.
        """
        params = self.params(preset)
        return rest_lattice(Detector(params).detect(self.read(data)).centres_px, params)


GELS = (
    RealGel("9dtact-1", "9dtact_calib/s1_sample.png", 7, 9, 0, "grey", _TACT, "9DTact, MIT licence"),
    RealGel("9dtact-2", "9dtact_calib/s2_sample.png", 7, 9, 0, "grey", _TACT, "9DTact, MIT licence"),
    RealGel("khsu", "khsu_markers/pic00.jpg", 8, 11, 9, "green", _KHSU, "gelsightmini_tracking, MIT licence"),
)


def draw(image: npt.NDArray[Any], lattice: RestLattice, cols: int, scale: int = 2) -> npt.NDArray[Any]:
    """Draw rows, markers (green), filled-in markers (red) and labels over an image."""
    canvas = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    positions = (lattice.positions_px + 0.5) * scale - 0.5
    for row in positions.reshape(-1, cols, 2):
        cv2.polylines(canvas, [np.round(row).astype(np.int32)], False, (255, 80, 0), 2, cv2.LINE_AA)
    for index, (position, filled) in enumerate(zip(positions, lattice.filled, strict=True)):
        x, y = (int(v) for v in np.round(position))
        cv2.circle(canvas, (x, y), 7, (0, 0, 255) if filled else (0, 120, 0), 2, cv2.LINE_AA)
        label = f"{index // cols},{index % cols}"
        cv2.putText(canvas, label, (x + 8, y - 8), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    return np.asarray(canvas)


def main(arguments: list[str] | None = None) -> int:
    """Fill docs/real-images.md and draw its pictures."""
    parser = argparse.ArgumentParser(prog="python -m gelstereo.reports.gels", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the real images")
    parser.add_argument("--docs", type=Path, default=Path("docs"), help="folder of the manual")
    options = parser.parse_args(arguments)
    rows = []
    for gel in GELS:
        print(gel.name)
        lattice = gel.locate(options.data)
        picture = draw(cv2.imread(str(options.data / gel.path)), lattice, gel.cols)
        cv2.imwrite(
            str(options.docs / "pictures" / f"real-{gel.name}.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, 85]
        )
        rows.append(
            [
                gel.name,
                f"{gel.rows} x {gel.cols}",
                str(int((~lattice.filled).sum())),
                str(int(lattice.filled.sum())),
                f"{lattice.pitch_px:.1f}",
                _foresight(gel, lattice),
                *(_verdict(gel, options.data, preset) for preset in Params.presets()),
            ]
        )
    head = ["image", "lattice", "found", "filled in", "pitch px", "foresight sort"]
    head += [f"preset {preset}" for preset in Params.presets()]
    replace_between(options.docs / "real-images.md", "gels", table(head, rows))
    return 0


def _foresight(gel: RealGel, lattice: RestLattice) -> str:
    """Say whether Algorithm 1 gives the complete lattice the same labels."""
    # Shuffled by a fixed stride, so that the order given cannot be the answer.
    count = gel.rows * gel.cols
    shuffled = np.argsort(np.arange(count) * 37 % count, kind="stable")
    tolerance_px = Params().to_dict()["label"]["tolerance_pitches"] * lattice.pitch_px
    try:
        order = foresight_sort(lattice.positions_px[shuffled], gel.rows, gel.cols, tolerance_px)
    except Error as error:
        return f"refuses: {error}"
    wrong = int((shuffled[order] != np.arange(count)).sum())
    return "same labels" if wrong == 0 else f"{wrong} wrong labels"


def _verdict(gel: RealGel, data: Path, preset: str) -> str:
    try:
        gel.locate(data, preset)
    except Error as error:
        return str(error)
    return "labelled"


if __name__ == "__main__":
    raise SystemExit(main())
