"""Pictures of docs/concepts.md: the sensor in section, the stages on one simulated frame, and what a pose
comes with.

Run ``python -m gelstereo_bench.reports.concepts`` in the repository to draw them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo import (
    Frame,
    Localization,
    Params,
    Pipeline,
    Scene,
    SimulatedFrame,
    Template,
    localize,
    simulate,
)
from gelstereo.extras import needs
from gelstereo.geometry import se3_exp, shape_mesh

with needs(__name__):
    import matplotlib

__all__ = ["Example", "main"]

Floats = npt.NDArray[np.float64]
_INK, _PART, _GEL, _TOUCH = "0.15", "#d9822b", "#cfe4f2", "#d43d3d"
#: Another part than the peg of the scene: flat where the peg is round. Its long side lies along the peg's
#: axis.
_BOX_MM = (7.0, 7.0, 20.0)
#: The simulated sensor's cameras and gel, sensor frame.
_BASELINE_MM, _SURFACE_MM, _GEL_MM, _PLATE_MM = 8.0, 28.7, 5.0, 3.0


@dataclass(frozen=True)
class Example:
    """The last frame of the scene of the first tutorial, and the peg found in it."""

    rest: Frame
    pair: SimulatedFrame
    frame: Frame
    shape: dict[str, Any]
    found: Localization
    #: A box in place of the peg.
    other: Localization

    @classmethod
    def of(cls, scene: Path) -> Example:
        """Sense the scene and locate its part from a guess beside the truth."""
        simulator, params = simulate(Scene.load(scene)), Params.preset("balanced")
        pipeline = Pipeline(simulator.scene.rig, params)
        frames = [
            (pair, pipeline.process(pair.left, pair.right))
            for pair in map(simulator.__getitem__, range(len(simulator)))
        ]
        pair, frame = frames[-1]
        assert pair.t_sensor_object is not None  # the scene has a part
        shape = simulator.scene.to_dict()["indenter"]
        guess = pair.t_sensor_object @ se3_exp([0.02, -0.02, 0.02, 0.3, -0.3, 0.3])

        def located(part: dict[str, Any]) -> Localization:
            return localize(
                frame.patch_points_mm,
                Template.from_triangles(*shape_mesh(part)),
                guess=guess,
                params=params,
                all_points_mm=frame.points_mm,
                covariance_mm2=frame.covariance_mm2[frame.patch],
            )

        return cls(
            frames[0][1], pair, frame, shape, located(shape), located({"kind": "box", "size_mm": _BOX_MM})
        )

    def profile_mm(self) -> Floats:
        """The outline of the peg at its pose, across its axis: x and z."""
        angle = np.linspace(0.0, 2.0 * np.pi, 200)
        centre = self.found.t_sensor_object[[0, 2], 3]
        return np.asarray(centre + self.shape["radius_mm"] * np.column_stack([np.cos(angle), np.sin(angle)]))


def draw_sensor(axis: Any) -> None:
    """A section through cameras, plate and gel with a part in it, to scale."""
    from matplotlib.patches import Circle, Polygon, Rectangle

    left, right = -6.5, 14.5
    plate = _SURFACE_MM - _GEL_MM - _PLATE_MM
    x = np.linspace(left, right, 300)
    dent = _dented(x)
    axis.add_patch(Circle((4.0, _SURFACE_MM + 2.0), 4.0, facecolor=_PART, edgecolor=_INK, zorder=1))
    axis.add_patch(Rectangle((left, plate), right - left, _PLATE_MM, facecolor="0.85", edgecolor="none"))
    outline = np.vstack([np.column_stack([x, dent]), [[right, plate + _PLATE_MM], [left, plate + _PLATE_MM]]])
    axis.add_patch(Polygon(outline, facecolor=_GEL, edgecolor="none", zorder=2))
    marks = np.arange(left + 0.75, right, 0.9)
    axis.plot(marks, _dented(marks), "o", color=_INK, markersize=4, zorder=4)
    axis.plot(x, np.full_like(x, _SURFACE_MM), "--", color="0.5", linewidth=1.0, zorder=3)
    for camera_mm, name in ((0.0, "left camera"), (_BASELINE_MM, "right camera")):
        axis.add_patch(Rectangle((camera_mm - 1.2, -2.6), 2.4, 2.0, facecolor="0.3", edgecolor="none"))
        axis.add_patch(
            Polygon([(camera_mm, -0.9), (camera_mm - 0.9, 0.2), (camera_mm + 0.9, 0.2)], facecolor="0.3")
        )
        marker = marks[np.argmin(np.abs(marks - 3.0))]
        axis.plot(
            [camera_mm, marker],
            [0.2, float(_dented(np.array([marker]))[0])],
            color=_TOUCH,
            linewidth=1.0,
            zorder=5,
        )
        axis.text(camera_mm, -3.2, name, ha="center", va="bottom", color=_INK)
    for tip, name, place in (((4.2, 0.2), "x", (4.6, 0.2)), ((0.0, 5.2), "z", (-0.9, 5.4))):
        axis.annotate(
            "", xy=tip, xytext=(0.0, 0.2), arrowprops={"arrowstyle": "-|>", "color": "#1f5fbf", "lw": 2}
        )
        axis.text(*place, name, color="#1f5fbf", fontsize=13, va="center", weight="bold")
    notes = (
        (plate + _PLATE_MM / 2, "plate (acrylic)"),
        (plate + _PLATE_MM + 2.0, "gel (clear)"),
        (_SURFACE_MM - 0.1, "markers; dashed: rest surface"),
        (_SURFACE_MM + 3.6, "part, presses towards the cameras"),
    )
    for height, text in notes:
        axis.text(right + 0.6, height, text, va="center", color=_INK)
    axis.annotate(
        "",
        xy=(-3.2, _dented(np.array([4.0]))[0]),
        xytext=(-3.2, _SURFACE_MM),
        arrowprops={"arrowstyle": "<->"},
    )
    axis.text(-3.5, _SURFACE_MM - 1.0, "indentation", ha="right", va="center")
    axis.set(xlim=(-10.5, 26.0), ylim=(35.5, -3.6), aspect="equal")
    axis.axis("off")


def _dented(x_mm: Floats) -> Floats:
    """Depth of the gel's surface below a round part 2 mm deep, with the gel beside it lifted."""
    away = np.abs(x_mm - 4.0)
    rim = 2.6
    under = _SURFACE_MM + 2.0 - np.sqrt(np.maximum(4.0**2 - np.minimum(away, rim) ** 2, 0.0))
    edge = _SURFACE_MM + 2.0 - np.sqrt(4.0**2 - rim**2)
    beside = _SURFACE_MM + (edge - _SURFACE_MM) * np.exp(-(away - rim) / 1.2)
    return np.asarray(np.where(away <= rim, under, beside))


def draw_stages(axes: Any, example: Example) -> None:
    """One frame after each stage."""
    frame, pair = example.frame, example.pair
    crop = (slice(150, 330), slice(300, 540))
    extent = (300.0, 540.0, 330.0, 150.0)
    rows, cols = np.divmod(np.arange(len(frame.left_px)), frame.cols)
    for axis in axes[0]:
        axis.set(xlim=extent[:2], ylim=extent[2:], xticks=[], yticks=[])
    axes[0][0].imshow(pair.left[crop], cmap="gray", extent=extent, vmin=0, vmax=255)
    axes[0][0].plot(*frame.left_px.T, "+", color=_TOUCH, markersize=7)
    axes[0][0].set_title("1 detect: a centre for every marker")
    axes[0][1].imshow(pair.left[crop], cmap="gray", extent=extent, vmin=0, vmax=255, alpha=0.45)
    for row in range(frame.rows):
        axes[0][1].plot(*frame.left_px[rows == row].T, color="C0", linewidth=0.8)
    for col in range(frame.cols):
        axes[0][1].plot(*frame.left_px[cols == col].T, color="C2", linewidth=0.8)
    axes[0][1].set_title("2 label: row and column of every marker")
    axes[0][2].imshow(pair.left[crop], cmap="gray", extent=extent, vmin=0, vmax=255, alpha=0.45)
    moved = frame.left_px - example.rest.left_px
    axes[0][2].quiver(
        *example.rest.left_px.T, *moved.T, angles="xy", scale_units="xy", scale=1.0, color=_TOUCH, width=0.004
    )
    axes[0][2].set_title("3 track: motion since rest, px")
    points = frame.points_mm
    shift = frame.left_px[:, 0] - frame.right_px[:, 0]
    _scatter(axes[1][0], points, shift, "disparity, px", "4 triangulate: disparity gives depth")
    _scatter(
        axes[1][1], points, frame.indentation_mm, "indentation, mm", "5 contact: indentation, and the patch"
    )
    touching = points[frame.patch]
    axes[1][1].plot(touching[:, 0], touching[:, 1], "o", markerfacecolor="none", color=_TOUCH, markersize=8)
    _draw_section(axes[1][2], example)
    axes[1][2].set_title("6 register: template on the patch")


def _scatter(axis: Any, points: Floats, values: Floats, unit: str, title: str) -> None:
    shown = axis.scatter(points[:, 0], points[:, 1], c=values, s=22, cmap="viridis")
    axis.figure.colorbar(shown, ax=axis, label=unit, shrink=0.85)
    axis.set(aspect="equal", xlabel="x, mm", ylabel="y, mm", title=title)
    axis.invert_yaxis()


def _draw_section(axis: Any, example: Example) -> None:
    """Markers of the middle rows from the side, with the outline of the part."""
    frame = example.frame
    middle = np.abs(frame.points_mm[:, 1]) < 1.5
    for chosen, colour, name in (
        (middle & ~frame.patch, "0.6", "other markers"),
        (middle & frame.patch, _TOUCH, "contact patch"),
    ):
        axis.plot(*frame.points_mm[chosen][:, [0, 2]].T, "o", color=colour, markersize=4, label=name)
    axis.plot(*example.profile_mm().T, color=_PART, linewidth=2.0, label=f"peg: {example.found.verdict}")
    axis.set(aspect="equal", xlabel="x, mm", ylabel="z, mm", xlim=(-4.0, 13.0), ylim=(35.5, 25.5))
    axis.legend(fontsize=8, loc="lower right")


def draw_pose(axes: Any, example: Example) -> None:
    """What comes with a pose: sigma of every direction, free directions, and a part that does not fit."""
    sigma = np.sqrt(np.diag(example.found.determined_covariance))[3:] * 1e3
    axes[0].bar(["x", "y (along the peg)", "z"], sigma, color="C0")
    axes[0].set(
        yscale="log",
        ylim=(0.5, 1000.0),
        ylabel="standard deviation, um",
        title="covariance: how well each direction is known",
    )
    for place, value in enumerate(sigma):
        axes[0].text(place, value * 1.1, f"{value:.0f}" if value >= 10 else f"{value:.1f}", ha="center")
    _draw_peg(axes[1])
    axes[1].set_title("free directions: motions that no marker shows")
    _draw_section(axes[2], example)
    half = _BOX_MM[0] / 2
    corners = half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0]])
    pose = example.other.t_sensor_object
    outline = corners @ pose[:3, :3].T + pose[:3, 3]
    axes[2].plot(*outline[:, [0, 2]].T, color="C4", linewidth=2.0, label=f"a box: {example.other.verdict}")
    axes[2].legend(fontsize=8, loc="lower right")
    axes[2].set_title("verdict: whether the part explains the contact")


def _draw_peg(axis: Any) -> None:
    """A peg with its two motions that change nothing."""
    from matplotlib.patches import Arc, Ellipse, Rectangle

    axis.add_patch(Rectangle((-6.0, -2.0), 12.0, 4.0, facecolor=_PART, edgecolor=_INK))
    axis.add_patch(Ellipse((6.0, 0.0), 1.6, 4.0, facecolor="#eaa862", edgecolor=_INK))
    axis.add_patch(Ellipse((-6.0, 0.0), 1.6, 4.0, facecolor=_PART, edgecolor=_INK, zorder=0))
    axis.annotate(
        "", xy=(10.5, 0.0), xytext=(6.0, 0.0), arrowprops={"arrowstyle": "-|>", "color": "#1f5fbf", "lw": 2}
    )
    axis.text(
        10.6, 0.0, " slide along z\n (if the ends do not\n touch the gel)", va="center", color="#1f5fbf"
    )
    axis.add_patch(Arc((0.0, 0.0), 2.6, 5.6, theta1=-75, theta2=75, edgecolor="#1f5fbf", linewidth=2))
    axis.annotate(
        "", xy=(0.2, 2.78), xytext=(0.6, 2.6), arrowprops={"arrowstyle": "-|>", "color": "#1f5fbf", "lw": 2}
    )
    axis.text(0.0, 3.6, "spin about z", ha="center", color="#1f5fbf")
    axis.set(xlim=(-8.0, 20.0), ylim=(-6.0, 6.0), aspect="equal")
    axis.axis("off")


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the pictures; the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", type=Path, default=Path("scenes/grasp_cylinder.toml"), help="%(default)s")
    parser.add_argument("--pictures", type=Path, default=Path("docs/pictures"), help="folder (%(default)s)")
    options = parser.parse_args(arguments)
    matplotlib.use("Agg")
    with needs(__name__):
        from matplotlib import pyplot as plt

    example = Example.of(options.scene)
    figure, axis = plt.subplots(figsize=(7.0, 7.3), layout="constrained")
    draw_sensor(axis)
    figure.savefig(options.pictures / "concept-sensor.png", dpi=90)
    figure, axes = plt.subplots(2, 3, figsize=(12.5, 7.2), layout="constrained", height_ratios=(0.85, 1.0))
    draw_stages(axes, example)
    figure.savefig(options.pictures / "concept-stages.png", dpi=90)
    figure, axes = plt.subplots(1, 3, figsize=(12.5, 3.9), layout="constrained")
    draw_pose(axes, example)
    figure.savefig(options.pictures / "concept-pose.png", dpi=90)
    plt.close("all")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
