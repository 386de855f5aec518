"""Every object that a user holds says what it is, with its main figures and their units."""

from __future__ import annotations

import inspect
import io
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import gelstereo as gs
from gelstereo import calibrate, cameras, grippers, hid, streams, templates

MODULES = [gs, calibrate, cameras, gs.geometry, grippers, hid, streams, templates]


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_every_public_class_has_a_repr(module: ModuleType) -> None:
    for name in getattr(module, "__all__", dir(module)):
        kind = getattr(module, name)
        if inspect.isclass(kind) and not issubclass(kind, BaseException):
            assert kind.__repr__ is not object.__repr__, f"{module.__name__}.{name}"


def test_reprs_say_figures_with_units(noisy_press: list[gs.SimulatedFrame], tmp_path: Path) -> None:
    rig = gs.Scene().rig
    pipeline = gs.Pipeline(rig)
    assert repr(pipeline) == "<Pipeline: images of 640 x 480 px, the next frame is the rest frame>"
    shown = noisy_press[-1]
    pipeline.process(noisy_press[0].left, noisy_press[0].right)
    frame = pipeline.process(shown.left, shown.right)
    assert repr(pipeline) == "<Pipeline: images of 640 x 480 px, at work>"
    rest = pipeline.rest
    assert rest is not None
    dense = gs.DenseSurface(rest.points_mm[:, :2], step_mm=0.5)
    scene = gs.Scene().replace(indenter={"kind": "sphere", "radius_mm": 4.0}, effects={"sensor_noise": {}})
    plan = gs.Simulator(scene).plan
    layer = gs.LayerContact(thickness_mm=4.0, poisson_ratio=0.48, rows=16, cols=8, cell_mm=0.5)
    template = gs.Template.from_triangles(
        *gs.geometry.shape_mesh({"kind": "box", "size_mm": [4.0, 5.0, 6.0]}), spacing_mm=0.5
    )
    localizer = gs.Localizer(template, guess=np.eye(4))
    words = {
        "<Detector: dark dots of 6 to 2000 px²>": gs.Detector(),
        "<RestSurface: 625 markers about": rest,
        "mm apart>": dense,
        "<SimulatedFrame 4 at 0.800 s: 625 markers, ": shown,
        "<SimulatedDots: 625 dots, 0 specks>": shown.left_dots,
        "us a frame>": plan,
        "um, ": plan.effects[0],
        "<LayerContact: 16 x 8 cells of 0.5 mm on a layer 4 mm thick, Poisson's ratio 0.48>": layer,
        "<LayerSolution: 16 x 8 cells, converged after 0 products, 0.0e0 mm left>": layer.load(
            np.zeros((16, 8))
        ),
        "not found yet>": localizer,
        "px, baseline ": rig.rectification(),
        "<FrameWriter: 0 frames written>": streams.FrameWriter(io.BytesIO()),
        "in contact": frame,
    }
    for text, value in words.items():
        assert text in repr(value), (text, repr(value))
        assert " object at 0x" not in repr(value)
