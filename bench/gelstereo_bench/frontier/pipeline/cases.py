"""What every scene of the front provides: stereo frames with truth, and the part in contact."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import trimesh

from gelstereo import Rig, Template
from gelstereo_bench.frontier.registering import Patch, observable_error_mm
from gelstereo_bench.frontier.scenes import Part

__all__ = ["MIN_TOUCHING", "Body", "Case", "Origin", "Shot", "Take"]

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Image = npt.NDArray[np.uint8]

#: Whose images they are.
Origin = Literal["simulated", "path-traced"]

#: Markers that must touch a part whose pose is judged: twice the six unknowns of a pose.
MIN_TOUCHING = 12


@dataclass(frozen=True)
class Body:
    """The part that is pressed into the gel."""

    name: str
    mesh: trimesh.Trimesh

    @cached_property
    def template(self) -> Template:
        """Samples 0.3 mm apart, as for the other tables of registration."""
        return Template.from_mesh(self.mesh, units="mm", spacing_mm=0.3).with_grid()

    @cached_property
    def symmetries(self) -> list[Array]:
        """(4, 4) rotations that map the part onto itself, the identity first.

        Rotations by any angle are left out, because they are free directions.
        """
        turns = [np.eye(4)]
        for found in self.template.with_symmetries().symmetries:
            if found.order is not None:
                angles = 2.0 * np.pi * np.arange(1, found.order) / found.order
                turns += [np.asarray(found.turned(float(angle)), np.float64) for angle in angles]
        return turns


@dataclass(frozen=True)
class Shot:
    """A stereo frame with its truth; points and poses are in the sensor frame, mm."""

    left: Image
    right: Image
    left_px: Array
    right_px: Array
    #: (N, 3) true marker positions in order.
    points_mm: Array
    #: (N,) markers whose depth counts; those under a reflection do not.
    counted: Flags
    #: (N,) markers that truly touch the part.
    touching: Flags
    body: Body | None = None
    t_sensor_object: Array | None = None

    @cached_property
    def patch(self) -> Patch | None:
        """The true contact; None if no part is in contact or too few markers touch it."""
        if self.body is None or self.t_sensor_object is None or self.touching.sum() < MIN_TOUCHING:
            return None
        part = Part(self.body.name, self.body.mesh, (0.0, 0.0, 0.0))
        return Patch(part, self.body.template, self.points_mm[self.touching], self.t_sensor_object)

    def pose_error_mm(self, found: Array) -> float:
        """Error of a pose over the determined directions, rotations at the patch's radius.

        A pose that a symmetry of the part maps onto the true one is right.
        """
        assert self.patch is not None and self.body is not None
        return min(observable_error_mm(self.patch, np.asarray(found @ turn)) for turn in self.body.symmetries)


@dataclass(frozen=True)
class Take:
    """One run of a scene: the first frame is untouched."""

    rig: Rig
    pitch_mm: float
    shots: Sequence[Shot]
    #: Frames whose pose is judged.
    judged: Sequence[int]
    #: Settings of the OpenCV pipeline, set by hand for the scene.
    by_hand: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    #: Whether light is refracted on its way from the markers.
    is_layered: bool = False


@dataclass(frozen=True)
class Case:
    """A fixed scene; each seed is another run of it."""

    name: str
    origin: Origin
    take: Callable[[int], Take]
