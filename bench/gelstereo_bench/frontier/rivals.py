"""Registration by other libraries, with settings for tactile patches; libraries that cannot be loaded are
left out.

``pip install './bench[rivals]'`` installs them. Each method takes a `Grasp` and a guess and returns a pose.
Settings were chosen on separate seeds (from 900), for success from 10 deg and 2 mm.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from typing import Any

import numpy as np
import numpy.typing as npt

from gelstereo_bench.frontier.grasps import Grasp

__all__ = ["Apart", "Method", "rivals"]

Array = npt.NDArray[np.float64]
#: Function from a grasp and a guess to the pose of the part in the sensor.
Method = Callable[[Grasp, Array], Array]


def rivals() -> tuple[dict[str, Method], dict[str, str]]:
    """Methods of the libraries that can be loaded, by name, and the reasons why others cannot."""
    known: dict[str, tuple[tuple[str, ...], Method]] = {
        "MeshLib: ICP on the mesh": (("meshlib.mrmeshpy", "meshlib.mrmeshnumpy"), meshlib_icp),
        "Open3D: ICP, point to plane, Tukey": (("open3d",), open3d_icp),
        "small_gicp: GICP": (("small_gicp",), small_gicp_align),
        "probreg: FilterReg, point to plane": (("probreg.filterreg",), probreg_filterreg),
    }
    reasons = {name: _missing(modules) for name, (modules, _) in known.items()}
    methods = {name: method for name, (_, method) in known.items() if reasons[name] is None}
    return methods, {name: reason for name, reason in reasons.items() if reason is not None}


def _missing(modules: tuple[str, ...]) -> str | None:
    """Reason why a module cannot be loaded; ``None`` if all can."""
    try:
        for module in modules:
            importlib.import_module(module)
    except ModuleNotFoundError as error:
        return f"{error.name} is not installed"
    except (ImportError, OSError) as error:
        # A missing shared library raises OSError through ctypes, ImportError through an extension.
        return f"cannot be loaded: {error}"
    return None


#: Maximum correspondence distances in order, mm.
_REACHES_MM = (3.0, 1.5, 0.6)
#: Tukey's constants in order, mm.
_TUKEY_MM = (1.0, 0.4, 0.12)


def open3d_icp(grasp: Grasp, guess: Array) -> Array:
    """Point-to-plane ICP on samples with Tukey's weights and a correspondence distance reduced in three
    steps.
    """
    import open3d as o3d

    registration = o3d.pipelines.registration
    source, target = _cloud(grasp.points_mm), _open3d_template(grasp)
    pose = np.linalg.inv(guess)
    for reach_mm, width_mm in zip(_REACHES_MM, _TUKEY_MM, strict=True):
        kernel = registration.TukeyLoss(k=width_mm)
        estimate = registration.TransformationEstimationPointToPlane(kernel)
        stop = registration.ICPConvergenceCriteria(max_iteration=40)
        pose = registration.registration_icp(source, target, reach_mm, pose, estimate, stop).transformation
    return np.linalg.inv(pose)


def small_gicp_align(grasp: Grasp, guess: Array) -> Array:
    """Generalised ICP on samples; the library estimates the patch's covariances from neighbourhoods."""
    import small_gicp

    target, tree = _kept(grasp, "small_gicp", lambda: small_gicp.preprocess_points(
        grasp.template.points_mm, downsampling_resolution=0.3, num_neighbors=10, num_threads=1
    ))  # fmt: skip
    source, _ = small_gicp.preprocess_points(
        grasp.points_mm, downsampling_resolution=0.3, num_neighbors=10, num_threads=1
    )
    pose = np.linalg.inv(guess)
    for reach_mm in _REACHES_MM:
        found = small_gicp.align(
            target,
            source,
            tree,
            init_T_target_source=pose,
            registration_type="GICP",
            max_correspondence_distance=reach_mm,
            num_threads=1,
        )
        pose = found.T_target_source
    return np.linalg.inv(pose)


#: Margin of the samples passed to FilterReg beyond the patch's farthest point, measured from its centroid,
#: mm.
_MARGIN_MM = 3.0


def probreg_filterreg(grasp: Grasp, guess: Array) -> Array:
    """FilterReg, point to plane, from the guess, on every second sample around it.

    It runs in a separate process: where planes leave a pose undetermined its steps diverge, and some end in a
    segmentation fault.
    """
    start = np.linalg.inv(guess)
    placed = grasp.points_mm @ start[:3, :3].T + start[:3, 3]
    centre = placed.mean(axis=0)
    reach_mm = np.linalg.norm(placed - centre, axis=1).max() + _MARGIN_MM
    points, normals = np.asarray(grasp.template.points_mm), np.asarray(grasp.template.normals)
    near = np.linalg.norm(points - centre, axis=1) < reach_mm
    motion = _APART.call(_filterreg, placed, points[near][::2], normals[near][::2])
    return np.asarray(np.linalg.inv(motion @ start), np.float64)


def _filterreg(placed_mm: Array, points_mm: Array, normals: Array) -> Array:
    """Motion of the placed points; the width decreases from 1 mm to at least 0.1 mm."""
    from probreg import filterreg

    found = filterreg.registration_filterreg(
        placed_mm,
        points_mm,
        target_normals=normals,
        objective_type="pt2pl",
        sigma2=1.0,
        update_sigma2=True,
        min_sigma2=0.1**2,
        w=0.1,
        maxiter=50,
    ).transformation
    motion = np.eye(4)
    # Its steps are multiplied up, and leave the rotations by more than a millionth.
    motion[:3, :3], motion[:3, 3] = _nearest_rotation(found.rot), found.t
    return motion


class Apart:
    """Calls functions in a separate process, which is replaced after a crash."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None

    def call(self, function: Callable[..., Any], *arguments: object) -> Any:
        """Return the function's result. The function and its arguments must be picklable.

        Raises
        ------
        RuntimeError
            If the process crashed.
        """
        if self._pool is None:
            self._pool = ProcessPoolExecutor(max_workers=1, mp_context=get_context("spawn"))
        try:
            return self._pool.submit(function, *arguments).result()
        except BrokenProcessPool:
            self._pool = None
            raise


_APART = Apart()


def meshlib_icp(grasp: Grasp, guess: Array) -> Array:
    """ICP of the patch on the part's triangles: first point to point, then point to plane."""
    from meshlib import mrmeshnumpy
    from meshlib import mrmeshpy as mr

    mesh = _kept(grasp, "meshlib", lambda: mrmeshnumpy.meshFromFacesVerts(
        np.asarray(grasp.mesh.faces, np.int32), np.asarray(grasp.mesh.vertices, np.float32)
    ))  # fmt: skip
    cloud = mrmeshnumpy.pointCloudFromPoints(np.asarray(grasp.points_mm, np.float32))
    start = np.linalg.inv(guess)
    transform = mr.AffineXf3f()
    transform.A = mr.Matrix3f(*(mr.Vector3f(*map(float, row)) for row in start[:3, :3]))
    transform.b = mr.Vector3f(*map(float, start[:3, 3]))
    icp = mr.ICP(
        mr.MeshOrPointsXf(cloud, transform), mr.MeshOrPointsXf(mesh, mr.AffineXf3f()), cloud.validPoints
    )
    settings = mr.ICPProperties()
    settings.method = mr.ICPMethod.Combined
    settings.iterLimit = 60
    settings.distThresholdSq = _REACHES_MM[0] ** 2
    settings.farDistFactor = 3.0
    settings.cosThreshold = -1.0
    icp.setParams(settings)
    found = icp.calculateTransformation()
    pose = np.eye(4)
    for row, vector in enumerate((found.A.x, found.A.y, found.A.z)):
        pose[row, :3] = vector.x, vector.y, vector.z
    # The library uses single precision.
    pose[:3, :3] = _nearest_rotation(pose[:3, :3])
    pose[:3, 3] = found.b.x, found.b.y, found.b.z
    return np.asarray(np.linalg.inv(pose), np.float64)


def _nearest_rotation(matrix: Array) -> Array:
    u, _, v = np.linalg.svd(matrix)
    return np.asarray(u @ v, np.float64)


#: Cache of the libraries' preprocessed templates, by library and part.
_STRUCTURES: dict[tuple[str, str], Any] = {}


def _kept(grasp: Grasp, library: str, make: Callable[[], Any]) -> Any:
    key = (library, grasp.part)
    if key not in _STRUCTURES:
        _STRUCTURES[key] = make()
    return _STRUCTURES[key]


def _cloud(points_mm: Array) -> Any:
    import open3d as o3d

    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(points_mm)))


def _open3d_template(grasp: Grasp) -> Any:
    import open3d as o3d

    def make() -> Any:
        cloud = _cloud(grasp.template.points_mm)
        cloud.normals = o3d.utility.Vector3dVector(np.array(grasp.template.normals))
        return cloud

    return _kept(grasp, "open3d", make)
