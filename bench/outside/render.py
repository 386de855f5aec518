"""Render the pairs of `sequences.toml` that are missing in data/images: `python -m outside.render [--list]
[NAME ...]`.

A picture is the sum of three: the print, as an emitter with its irradiance, seen through the layers by a thin
lens; tray and mount in the same way; and the lights' reflections in the acrylic's front. A pair then takes
seconds, without the noise of pure path tracing. Needs `requirements.txt` and LLVM (DRJIT_LIBLLVM_PATH).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import drjit as dr
import mitsuba as mi
import numpy as np
import numpy.typing as npt
import tomllib

mi.set_variant("llvm_ad_mono")

# Mitsuba's classes exist only after a variant is set.
from . import contacts, light, scene  # noqa: E402
from .fields import Field  # noqa: E402
from .optics import Camera, Optics  # noqa: E402
from .prints import Print, Skin  # noqa: E402

Array = npt.NDArray[np.float64]

HERE = Path(__file__).parent
DATA = HERE / "data" / "images"
SAMPLES, PHOTONS = 48, 3_000_000
WHITE_LEVEL = 165.0


def table() -> dict[str, Any]:
    """`sequences.toml`."""
    return tomllib.loads((HERE / "sequences.toml").read_text())


class Sensor:
    """One sensor: optics, print, surroundings, and the parts of its pictures that contact does not change."""

    def __init__(self, entry: dict[str, Any]) -> None:
        gel = contacts.table()["gels"][entry["gel"]]
        self.optics = Optics(gel["thickness_mm"])
        self.print = Print(entry["pitch_mm"], entry["radius_mm"], entry["print_seed"])
        self.around = scene.Surroundings(strip_y_mm=entry["strip_y_mm"])
        self.lights = tuple(entry["lights"])
        self.focus_mm = 20.0 + 3.0 / 1.49 + gel["thickness_mm"] / 1.41 - 0.4
        self.reflectance = self.print.reflectance()
        self.flat = Skin.flat(self.print.half_mm, self.optics.surface_mm)
        self.lit = lru_cache(self._lit)
        self.glints = lru_cache(self._glints)
        self.at_rest = lru_cache(self._at_rest)
        self.exposure = 1.0
        image = self.at_rest("left", self.lights)
        self.exposure = WHITE_LEVEL / float(np.median(image[image > 0.5 * np.percentile(image, 90)]))

    def levels(self, lights: tuple[float, float]) -> dict[str, float]:
        return {"a": lights[0], "b": lights[1]}

    def _lit(self, lights: tuple[float, float]) -> light.Light:
        """Light on print and tray at rest; contacts hardly change the light on the tray."""
        return light.traced(self.optics, self.around, self.flat, self.levels(lights), PHOTONS, 0)

    def texture(self, irradiance: Array) -> Array:
        """Radiance of the print at an exposure of 1."""
        smooth = cv2.resize(irradiance, self.reflectance.shape[::-1], interpolation=cv2.INTER_CUBIC)
        # Cubic interpolation may undershoot.
        return np.asarray(self.reflectance * np.maximum(smooth, 0.0) / np.pi)

    def see(self, camera: Camera, surface: Skin, texture: Array, **more: Any) -> Array:
        """Image of the emitting print alone."""
        world = mi.load_dict(
            {
                "type": "scene",
                "integrator": {"type": "sight"},
                "sensor": scene.sensor(camera, self.focus_mm, SAMPLES),
                **scene.interfaces(self.optics, "clear"),
                "skin": scene.skin(surface, self.optics, texture),
                **more,
            }
        )
        return np.array(mi.render(world, seed=1), dtype=float).squeeze()

    def scenery(self, view: str, surface: Skin, texture: Array, lights: tuple[float, float]) -> Array:
        """Print, tray and mount through the layers, at an exposure of 1."""
        parts = scene.rings(self.optics, self.around, surface.half_mm)
        fronts = scene.glowing(parts, self.lit(lights).on_rings, light.REACH_MM)
        return self.see(getattr(self.optics, view), surface, texture, **fronts)

    def _at_rest(self, view: str, lights: tuple[float, float]) -> Array:
        return self.scenery(view, self.flat, self.texture(self.lit(lights).on_print), lights)

    def _glints(self, view: str, lights: tuple[float, float]) -> Array:
        """The lights' reflections in the acrylic's front, at an exposure of 1."""
        mount = scene.rings(self.optics, self.around, self.print.half_mm)["mount"]
        world = {
            "type": "scene",
            "integrator": {"type": "sight", "turns": 1},
            "sensor": scene.sensor(getattr(self.optics, view), self.focus_mm, SAMPLES),
            "front": scene.interfaces(self.optics, "clear", bounces=True)["interface_0"],
            **scene.lights(self.around, self.levels(lights)),
            **scene.tray({"mount": mount}),
        }
        return np.array(mi.render(mi.load_dict(world), seed=2), dtype=float).squeeze()

    def pair(self, frame: Any, lights: tuple[float, float], seed: int) -> dict[str, npt.NDArray[np.uint8]]:
        """Both images, clean. All frames at rest under the same light are the same."""
        images, surface = {}, self.surface(frame)
        if frame != "rest":
            found = light.traced(self.optics, self.around, surface, self.levels(lights), PHOTONS, seed)
            texture = self.texture(found.on_print)
        for view in ("left", "right"):
            at_rest = frame == "rest"
            image = self.at_rest(view, lights) if at_rest else self.scenery(view, surface, texture, lights)
            exposed = self.exposure * (image + self.glints(view, lights))
            images[view] = np.clip(np.rint(exposed), 0, 255).astype(np.uint8)
        return images

    def truth(self, surface: Skin, frame: Any) -> dict[str, Array]:
        """Markers' true places (sensor frame, mm), pixels, normals and contact."""
        dots, _ = self.print.dots()
        points = surface.at(dots)
        left, right = self.optics.project(points)
        found = {"points_mm": self.optics.in_sensor_frame(points), "left_px": left, "right_px": right}
        found["normals"] = surface.normals(dots) @ self.optics.left.rotation
        found["touching"] = np.zeros(len(dots), dtype=bool)
        if frame != "rest":
            name, stage, x, y = frame
            found["touching"] = Field.load(name).touching(stage, dots - [x, y])
        return found

    def surface(self, frame: Any) -> Skin:
        """The print's surface in a frame."""
        half, height = self.print.half_mm, self.optics.surface_mm
        if frame == "rest":
            return self.flat
        name, stage, x, y = frame
        along = np.linspace(-half, half, 2 * round(half / 0.1) + 1)
        v, u = np.meshgrid(along, along, indexing="ij")
        points = np.stack((u.ravel() - x, v.ravel() - y), axis=1)
        motion = Field.load(name).motion(stage, points).reshape(len(along), len(along), 3)
        return Skin.moved(along, motion, half, height)


def render(entry: dict[str, Any], sensors: dict[str, Any]) -> None:
    """Render all missing pairs of a sequence, and then its truth."""
    sensor = Sensor(sensors[entry["sensor"]])
    lights = entry.get("lights") or [list(sensor.lights)] * len(entry["frames"])
    truths = []
    for k, (frame, level) in enumerate(zip(entry["frames"], lights, strict=True)):
        started = time.process_time()
        surface = sensor.surface(frame)
        truths.append(sensor.truth(surface, frame))
        if path_of(entry["name"], k, "right").exists():
            continue
        for view, image in sensor.pair(frame, tuple(level), seed=k + 1).items():
            cv2.imwrite(str(path_of(entry["name"], k, view)), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])
        sys.stderr.write(f"{entry['name']} {k}: {time.process_time() - started:.1f} s of CPU time\n")
    stacked = {key: np.stack([t[key] for t in truths]) for key in truths[0]}
    packed = {key: a if a.dtype == bool else a.astype(np.float32) for key, a in stacked.items()}
    about = {
        "half": sensors[entry["sensor"]]["half"],
        "pitch_mm": sensor.print.pitch_mm,
        "frames": entry["frames"],
    }
    about |= {"sensor": entry["sensor"], "lights": lights, "rig": sensor.optics.rig_toml()}
    np.savez_compressed(DATA / f"{entry['name']}.npz", about=json.dumps(about), **packed)


def path_of(name: str, index: int, view: str) -> Path:
    """One image's file."""
    return DATA / f"{name}_{index:02d}_{view}.png"


def missing(entry: dict[str, Any]) -> list[int]:
    """Frames of a sequence that are not rendered."""
    rest = [k for k in range(len(entry["frames"])) if not path_of(entry["name"], k, "right").exists()]
    return rest or ([] if (DATA / f"{entry['name']}.npz").exists() else [0])


def main(arguments: Sequence[str] | None = None) -> int:
    """Render the missing pairs, or list them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="sequences; all without")
    parser.add_argument("--list", action="store_true", help="say what is left to render")
    options = parser.parse_args(arguments)
    sequences = table()
    DATA.mkdir(parents=True, exist_ok=True)
    # Two threads by default, to leave processors to other programs.
    dr.set_thread_count(int(os.environ.get("OUTSIDE_THREADS", "2")))
    for entry in sequences["sequences"]:
        left = missing(entry)
        if not left or (options.names and entry["name"] not in options.names):
            continue
        used = {f[0] for f in entry["frames"] if f != "rest"}
        unsolved = [n for n in sorted(used) if not (contacts.DATA / f"{n}.npz").exists()]
        reason = f"; unsolved: {', '.join(unsolved)}" if unsolved else ""
        sys.stderr.write(f"{entry['name']}: {len(left)} of {len(entry['frames'])} pairs left{reason}\n")
        if not options.list and not unsolved:
            render(entry, sequences["sensors"])
    return 0


if __name__ == "__main__":
    sys.exit(main())
