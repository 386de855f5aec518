"""What an image of a gel shows: its dots, their layout, and the settings that fit them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from gelstereo._native import DetectError, Detector, Error, ImageError, Markers, Params, rest_lattice

from .layout import Layout, LayoutKind, layout_of

#: `inspect` and `Inspection` are names of the package itself.
__all__ = ["Layout", "LayoutKind"]

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
Channel = Literal["grey", "red", "green", "blue"]
Polarity = Literal["dark", "bright"]

#: Dots of one print differ in area by less than this factor, also in perspective; specks and clutter lie
#: outside.
_SAME_AREA = 2.5
#: Tried where the preset's `detect.background_kernel_px` shows no whole print: dots as wide as the kernel
#: pass for background.
_WIDER_KERNELS_PX = (121, 253)
#: `detect.background_kernel_px` is kept while it is within these distances of neighbours.
_KERNEL_SPACINGS = (2.0, 4.0)


@dataclass(frozen=True)
class Inspection:
    """What an image shows. ``str()`` puts it into words."""

    #: Width and height.
    size_px: tuple[int, int]
    #: Channel in which the print shows best; ``"grey"`` for a grey image.
    channel: Channel
    #: Whether the dots are darker or brighter than the gel.
    polarity: Polarity
    #: Centres (N, 2) of the dots of the print. Components of another size are not contained.
    dots_px: Array
    #: Number of components of another size: specks and clutter.
    others: int
    #: Median diameter of the dots' area.
    dot_px: float
    #: Median difference of dot and gel, grey levels.
    contrast: float
    #: Standard deviation of the pixels' noise, grey levels.
    noise: float
    #: Arrangement of the dots.
    layout: Layout
    #: Name of the preset that was tried.
    preset: str
    #: What the preset makes of the image: "25 rows x 25 columns", or its error.
    preset_result: str
    #: The same with `settings`.
    settings_result: str
    #: Settings that differ from the preset, by their dotted names.
    settings: Mapping[str, Any]

    @property
    def params(self) -> Params:
        """The preset with `settings`."""
        return Params.preset(self.preset).replace(dict(self.settings))

    def to_toml(self) -> str:
        """The settings as text for a configuration of `gelstereo-host`; in Python, `params` has them."""
        tables: dict[str, list[str]] = {}
        for name, value in self.settings.items():
            table, _, key = name.rpartition(".")
            text = f'"{value}"' if isinstance(value, str) else str(value)
            tables.setdefault(table, []).append(f"{key} = {text}")
        lines = [f'preset = "{self.preset}"']
        for table, settings in tables.items():
            lines += ["", f"[params.{table}]", *settings]
        return "\n".join([*lines, ""])

    def __str__(self) -> str:
        width, height = self.size_px
        lines = [f"image     {width} x {height} px, {self.channel} channel, noise {self.noise:.1f} levels"]
        if not len(self.dots_px):
            return "\n".join([*lines, "dots      none: no blobs stand out from their surroundings"])
        others = f"; {self.others} blobs of other sizes" if self.others else ""
        lines += [
            f"dots      {len(self.dots_px)} {self.polarity} ones of {self.dot_px:.1f} px, contrast "
            f"{self.contrast:.0f} levels{others}",
            f"layout    {_layout_in_words(self.layout)}",
        ]
        if self.layout.rows:
            lines.append(f"lattice   {_lattice_in_words(self.layout)}")
            lines.append(
                f"shape     {self.layout.bend_px:.1f} px rms from a plane seen in perspective; largest step "
                f"{self.layout.perspective:.2f} times the smallest"
            )
        lines += [f"{self.preset:<9} {self.preset_result}"]
        if self.settings:
            lines += [f"settings  {self.settings_result}, with"]
            lines += [
                f"          {name} = {value!r}".replace("'", '"') for name, value in self.settings.items()
            ]
        return "\n".join(lines)


def inspect(image: Image, *, preset: str = "balanced", outline_px: npt.ArrayLike | None = None) -> Inspection:
    """Find out what an image of a gel shows.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Image of a gel at rest, grey or blue, green and red as OpenCV reads it.
    preset
        Preset to try, and to start the settings from.
    outline_px : (N, 2)
        Corners of a polygon around the gel; what lies outside is left out. It is no part of `settings`, since
        it holds for one view: set `detect.roi.left_outline_px` and `detect.roi.right_outline_px`.

    Raises
    ------
    ImageError
        If the array is not an image.
    """
    base = Params.preset(preset)
    if outline_px is not None:
        corners_px = np.asarray(outline_px, np.float64).tolist()
        base = base.replace({"detect.roi.left_outline_px": corners_px})
    height, width = np.shape(image)[:2] if np.ndim(image) in (2, 3) else (0, 0)
    best = _best_print(image, base)
    plain = _Trial.of(image, base)
    settings, tried = _settings(image, base, best, plain)
    return Inspection(
        size_px=(int(width), int(height)),
        channel=best.channel,
        polarity=best.polarity,
        dots_px=best.dots_px,
        others=best.others,
        dot_px=best.dot_px,
        contrast=best.contrast,
        noise=best.noise,
        layout=best.layout,
        preset=preset,
        preset_result=plain.words,
        settings_result=tried.words,
        settings=settings,
    )


def _best_print(image: Image, base: Params) -> _Print:
    """The print of either polarity; behind a wider background where the preset's shows no whole print."""
    kernels_px = [base.to_dict()["detect"]["background_kernel_px"]]
    sides_px = np.shape(image)[:2] if np.ndim(image) in (2, 3) else (0, 0)
    kernels_px += [px for px in _WIDER_KERNELS_PX if kernels_px[0] < px < min(sides_px)]
    best: _Print | None = None
    for kernel_px in kernels_px:
        found = [_Print.find(image, base, polarity, kernel_px) for polarity in ("dark", "bright")]
        if best is not None:
            found.insert(0, best)
        best = max(found, key=lambda each: each.score)
        if best.layout.kind != "irregular" and best.layout.is_whole:
            break
    assert best is not None
    return best


def _settings(image: Image, base: Params, best: _Print, plain: _Trial) -> tuple[dict[str, Any], _Trial]:
    """Settings for a print and what they make of the image, without those that make it worse."""
    settings = best.settings(base) if len(best.dots_px) else {}
    tried = _Trial.of(image, base.replace(settings)) if settings else plain
    for name in ("detect.background_kernel_px", "detect.dot_px"):
        fewer = {other: value for other, value in settings.items() if other != name}
        without = _Trial.of(image, base.replace(fewer)) if name in settings else tried
        if without.labelled > tried.labelled:
            settings, tried = fewer, without
    return ({}, plain) if tried.labelled < plain.labelled else (settings, tried)


@dataclass(frozen=True)
class _Trial:
    """What detection and lattice make of an image."""

    #: Markers with row and column that were seen; 0 if the image is refused.
    labelled: int
    words: str

    @classmethod
    def of(cls, image: Image, params: Params) -> _Trial:
        try:
            lattice = rest_lattice(Detector(params, view="left").detect(image).centres_px, params)
        except Error as error:
            return cls(0, f"refuses it: {error}")
        missing = int(np.count_nonzero(lattice.filled))
        words = f"labels {lattice.rows} rows x {lattice.cols} columns"
        return cls(lattice.rows * lattice.cols - missing, words + (f", {missing} missing" if missing else ""))


@dataclass(frozen=True)
class _Print:
    """The dots of one polarity."""

    channel: Channel
    polarity: Polarity
    dots_px: Array
    others: int
    dot_px: float
    contrast: float
    noise: float
    layout: Layout

    @classmethod
    def find(cls, image: Image, base: Params, polarity: Polarity, kernel_px: int) -> _Print:
        params = base.replace(
            {
                "detect.polarity": polarity,
                "detect.background_kernel_px": kernel_px,
                "detect.dot_px": [2.0, float(kernel_px)],
            }
        )
        markers: Markers | None = None
        try:
            markers = Detector(params, view="left").detect(image)
        except ImageError:
            raise
        except DetectError:
            pass
        channel: Channel = "grey" if markers is None else markers.channel
        levels = _levels(image, channel)
        noise = _noise(levels)
        if markers is None or not len(markers):
            nothing = np.zeros((0, 2))
            return cls(channel, polarity, nothing, 0, float("nan"), 0.0, noise, layout_of(nothing))
        alike = _alike(markers.area_px2)
        dots = markers.centres_px[alike]
        diameter = float(2.0 * np.sqrt(np.median(markers.area_px2[alike]) / np.pi))
        layout = layout_of(dots)
        contrast = _contrast(levels, dots, 0.5 * diameter, layout.spacing_px)
        return cls(channel, polarity, dots, int((~alike).sum()), diameter, contrast, noise, layout)

    @property
    def score(self) -> float:
        """How much this looks like a print: dots on a lattice and their contrast over noise.

        The gaps of a print are a lattice of the other polarity, of less contrast.
        """
        regular = 1.0 if self.layout.kind != "irregular" else 0.2
        return regular * len(self.dots_px) * self.contrast / max(self.noise, 1.0)

    def settings(self, base: Params) -> dict[str, Any]:
        """Settings that differ from a preset's."""
        preset = base.to_dict()["detect"]
        settings: dict[str, Any] = {}
        if preset["polarity"] != self.polarity:
            settings["detect.polarity"] = self.polarity
        if self.channel != "grey":
            settings["detect.channel"] = self.channel
        spacing = max(self.layout.spacing_px)
        low, high = (times * spacing for times in _KERNEL_SPACINGS)
        if np.isfinite(spacing) and not low <= preset["background_kernel_px"] <= high:
            settings["detect.background_kernel_px"] = int(np.clip(2.5 * spacing, 9, 253)) | 1
        area = np.pi * (0.5 * self.dot_px) ** 2
        if (
            self.others > 0.05 * len(self.dots_px)
            or not 2 * preset["min_area_px2"] < area < 0.5 * preset["max_area_px2"]
        ):
            least, most = self.dot_px * _SAME_AREA**-0.5, self.dot_px * _SAME_AREA**0.5
            settings["detect.dot_px"] = [max(float(np.floor(least)), 1.0), float(np.ceil(most))]
        if self.layout.kind == "hexagonal":
            settings["lattice.layout"] = "hexagonal"
        if self.layout.kind != "irregular" and self.layout.is_whole:
            settings["lattice.rows"], settings["lattice.cols"] = self.layout.rows, self.layout.cols
        return settings


def _alike(area_px2: npt.NDArray[np.uint32]) -> npt.NDArray[np.bool_]:
    """The largest population of about equal areas."""
    logs = np.log(np.maximum(area_px2, 1))
    order = np.sort(logs)
    reach = np.log(_SAME_AREA)
    count = np.searchsorted(order, order + reach, side="right") - np.arange(len(order))
    start = int(np.argmax(count))
    middle = np.median(order[start : start + int(count[start])])
    return np.asarray(np.abs(logs - middle) <= reach)


def _levels(image: Image, channel: Channel) -> Image:
    import cv2

    if image.ndim == 2:
        return image
    place = {"blue": 0, "green": 1, "red": 2}.get(channel)
    return np.asarray(
        cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if place is None else image[..., place], np.uint8
    )


def _noise(levels: Image) -> float:
    """From the median second difference along rows, which has the variance of six pixels."""
    rows = levels[::2].astype(np.int16)
    second = np.abs(2 * rows[:, 1:-1] - rows[:, :-2] - rows[:, 2:])
    # A median of whole numbers is refined by the share of its own number that lies below it.
    counts = np.bincount(second.ravel(), minlength=2)
    below = np.cumsum(counts)
    half = 0.5 * below[-1]
    at = int(np.searchsorted(below, half))
    share = (half - (below[at] - counts[at])) / max(int(counts[at]), 1)
    return float(max(at - 0.5 + share, 0.0) / (0.6745 * 6.0**0.5))


def _contrast(levels: Image, dots: Array, radius_px: float, spacing_px: tuple[float, float]) -> float:
    """Median difference between the middle of the dots and the gel around them."""
    between = 0.5 * min(spacing_px) if np.isfinite(spacing_px[0]) else np.inf
    ring = max(min(2.0 * radius_px, between), 1.2 * radius_px)
    turns = np.arange(8) * np.pi / 4
    around = ring * np.column_stack([np.cos(turns), np.sin(turns)])
    height, width = levels.shape

    def at(points: Array) -> Array:
        x, y = np.round(points).astype(int).T
        return np.asarray(levels[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)], np.float64)

    inside = np.mean([at(dots + [x, y]) for x in (-0.5, 0.5) for y in (-0.5, 0.5)], axis=0)
    outside = np.median([at(dots + step) for step in around], axis=0)
    return float(np.median(np.abs(outside - inside)))


def _layout_in_words(layout: Layout) -> str:
    if layout.kind == "irregular":
        if not np.isfinite(layout.spacing_px[0]):
            return "too few dots for a layout"
        share = f"{100 * layout.on_lattice:.0f} % on a lattice"
        return f"irregular: neighbours {layout.spacing_px[0]:.1f} px apart, {share}"
    across, down = layout.spacing_px
    spacing = (
        f"{across:.1f} px"
        if layout.kind == "square"
        else f"{across:.1f} px along rows, {down:.1f} px between rows"
    )
    share = f"{100 * layout.on_lattice:.0f} % of the dots on it"
    return f"{layout.kind}: {spacing}, at {layout.angle_deg:.0f} degrees; {share}"


def _lattice_in_words(layout: Layout) -> str:
    words = f"{layout.rows} rows x {layout.cols} columns, {100 * layout.filled:.0f} % of the places filled"
    sides = ("upper row", "lower row", "left column", "right column")
    partly = [
        f"{side} seen to {100 * share:.0f} %"
        for side, share in zip(sides, layout.borders, strict=True)
        if share < 0.8
    ]
    return words + ("; " + ", ".join(partly) if partly else "; every border line is whole")
