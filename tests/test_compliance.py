"""Compliance matrices of finite gels: against the exact layer, another finite-element program, and as an
estimator uses them.
"""

from __future__ import annotations

import contextlib
import math
import pickle
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import gelstereo as gs
from gelstereo.cli.main import main
from gelstereo.force import compute_compliance
from gelstereo.force.background import in_background

Array = npt.NDArray[np.float64]

ROWS, COLS, PITCH_MM, THICKNESS_MM, NU = 5, 6, 1.0, 2.0, 0.47
RIM_MM = (1.0, 1.5)


@cache
def narrow() -> gs.Compliance:
    return compute_compliance(
        rows=ROWS, cols=COLS, pitch_mm=PITCH_MM, thickness_mm=THICKNESS_MM, poisson_ratio=NU, rim_mm=RIM_MM
    )


def test_a_command_writes_the_same_matrix_and_steps_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[tuple[int, int]] = []
    monkeypatch.setattr(
        "gelstereo.force.compliance_command.Progress",
        lambda _: contextlib.nullcontext(lambda done, total: steps.append((done, total))),
    )
    gel = f"--rows {ROWS} --cols {COLS} --pitch-mm {PITCH_MM} --thickness-mm {THICKNESS_MM}"
    rest = f"--poisson-ratio {NU} --rim-mm {RIM_MM[0]} {RIM_MM[1]} --output {tmp_path / 'new/gel.compliance'}"
    assert main(["compliance", *gel.split(), *rest.split()]) == 0
    made = gs.Compliance.load(tmp_path / "new/gel.compliance")
    assert np.array_equal(made.matrix(), narrow().matrix())
    assert [done for done, _ in steps] == list(range(steps[-1][1] + 1))


def test_the_other_process_hands_back_its_errors_and_its_end() -> None:
    # Both take the function of the steps for their argument.
    with pytest.raises(TypeError, match="must be real number, not function"):
        in_background(math.sqrt)
    with pytest.raises(ChildProcessError, match="ended with code 1; was there enough memory"):
        in_background(sys.exit)


def lattice() -> Array:
    x, y = np.meshgrid(np.arange(COLS) - (COLS - 1) / 2, np.arange(ROWS) - (ROWS - 1) / 2)
    return np.column_stack([x.ravel(), y.ravel(), np.full(ROWS * COLS, 30.0)]) * (PITCH_MM, PITCH_MM, 1.0)


def test_a_wide_gel_moves_like_the_layer() -> None:
    """The layer's influence is from Fourier's transform, and is tested against tamaas and mpmath."""
    made = compute_compliance(rows=4, cols=3, pitch_mm=1.0, thickness_mm=1.5, poisson_ratio=NU, rim_mm=6.0)
    matrix = made.matrix()
    layer = gs.LayerContact(thickness_mm=1.5, poisson_ratio=NU, rows=4, cols=3, cell_mm=1.0)
    for cell, component in np.ndindex(12, 3):
        load = np.zeros((12, 3))
        load[cell, component] = 1.0
        expected = layer.load(load[:, 0].reshape(4, 3), load[:, 1:].reshape(4, 3, 2)).motion_mm
        error = np.abs(matrix[:, :, cell, component] - expected.reshape(12, 3)[:, [2, 0, 1]]).max()
        assert error < 2e-3 * expected.max()


def test_the_matrix_is_symmetric() -> None:
    """By Betti's reciprocity, up to the difference of a marker and the cell around it, which is largest at a
    side.
    """
    matrix = narrow().matrix().reshape(3 * ROWS * COLS, -1)
    assert np.abs(matrix - matrix.T).max() < 0.015 * matrix.max()
    assert np.linalg.eigvalsh(matrix + matrix.T).min() > 0


def test_another_program_moves_the_narrow_gel_alike() -> None:
    """scikit-fem, on another mesh, without symmetry and without a correction close to the load.

    The loaded cell is beside the middle. Beyond its neighbours, both programs agree to the error of this
    coarse mesh. With elements half as wide, which takes half a minute, they agree within 1.5 %.
    """
    import skfem
    from skfem.helpers import ddot, div, sym_grad

    edges = [(np.arange(count + 1) - count / 2) * PITCH_MM for count in (COLS, ROWS)]
    x, y = (np.concatenate([[-3.5], inner, [3.5]]) for inner in edges)
    mesh = skfem.MeshHex.init_tensor(x, y, np.array([0.0, 1.0, 1.6, 2.0]))
    element = skfem.ElementVector(skfem.ElementHex2())
    basis = skfem.Basis(mesh, element, intorder=5)
    shear, lame = 0.5 / (1 + NU), NU / ((1 + NU) * (1 - 2 * NU))

    @skfem.BilinearForm
    def stiffness(u: Any, v: Any, _: Any) -> Any:
        return 2 * shear * ddot(sym_grad(u), sym_grad(v)) + lame * div(u) * div(v)

    cell = 2 * COLS + 2
    middle = lattice()[cell, :2]
    over_cell = mesh.facets_satisfying(
        lambda p: (p[2] > THICKNESS_MM - 1e-9) & (np.abs(p[:2].T - middle).max(axis=1) < PITCH_MM / 2).T
    )
    top = skfem.FacetBasis(mesh, element, facets=over_cell, intorder=4)
    held = np.flatnonzero(basis.doflocs[2] < 1e-9)
    matrix = stiffness.assemble(basis)
    places = np.column_stack([lattice()[:, :2], np.full(ROWS * COLS, THICKNESS_MM)])
    # Markers are nodes of this mesh, with three displacements each.
    nodes = [np.flatnonzero(np.abs(basis.doflocs.T - place).max(axis=1) < 1e-9) for place in places]
    far = np.abs(lattice()[:, :2] - middle).max(axis=1) > 1.5 * PITCH_MM
    into = (-1.0, 1.0, 1.0)
    for component, axis in enumerate((2, 0, 1)):
        load = skfem.LinearForm(lambda v, _, axis=axis: v[axis]).assemble(top)
        moved = skfem.solve(*skfem.condense(matrix, into[component] * load, D=held))[np.array(nodes)]
        expected = moved[:, [2, 0, 1]] * into
        found = narrow().matrix()[:, :, cell, component]
        assert np.linalg.norm((found - expected)[far]) < 0.1 * np.linalg.norm(expected[far])


def moved_by(tractions: Array, seed: int) -> tuple[Array, Array]:
    """Markers under these tractions over Young's modulus, with noise, and the covariance."""
    into, x, y = (narrow().matrix().reshape(3 * len(tractions), -1) @ tractions.ravel()).reshape(-1, 3).T
    sigma_mm = np.array([0.0015, 0.0015, 0.005])
    noise = np.random.default_rng(seed).normal(size=(len(tractions), 3)) * sigma_mm
    # The camera sees the gel from below: into the layer is -z of the sensor.
    return lattice() + np.column_stack([x, y, -into]) + noise, np.tile(
        np.diag(sigma_mm**2), (len(noise), 1, 1)
    )


def estimator(compliance: gs.Compliance | None, **settings: Any) -> gs.ForceEstimator:
    force = {"method": "ridge", "thickness_mm": THICKNESS_MM, "young_kpa": 100.0, "poisson_ratio": NU}
    return gs.ForceEstimator(
        gs.RestSurface(lattice()),
        gs.Params().replace(force={**force, **settings}),
        cols=COLS,
        covariance_mm2=np.tile(1e-12 * np.eye(3), (ROWS * COLS, 1, 1)),
        compliance=compliance,
    )


def test_the_wrench_of_a_narrow_gel_needs_its_matrix() -> None:
    patch = (np.abs(lattice()[:, :2]) < 1.1).all(axis=1)
    tractions = np.where(patch[:, None], (0.05, 0.01, -0.005), 0.0)
    force_n = tractions.sum(axis=0) * 100.0 * PITCH_MM**2 * 1e-3
    errors: dict[bool, list[Array]] = {False: [], True: []}
    for seed in range(20):
        points, covariance = moved_by(tractions, seed)
        for has_matrix in errors:
            _, wrench = estimator(narrow() if has_matrix else None).run(points, covariance, patch.tolist())
            assert wrench is not None
            error = np.array([-wrench.force_n[2], *wrench.force_n[:2]]) - force_n
            errors[has_matrix].append(error / force_n[0])
    # Of one frame, the noise of such a small lattice is 6 % of the pressing force.
    assert np.abs(np.mean(errors[True], axis=0)).max() < 0.03
    assert np.abs(np.mean(errors[False], axis=0)).max() > 0.2


def test_a_matrix_is_stored_and_pickled(tmp_path: Path) -> None:
    made = narrow()
    made.save(tmp_path / "gel.compliance")
    for copy in (gs.Compliance.load(tmp_path / "gel.compliance"), pickle.loads(pickle.dumps(made))):
        assert np.array_equal(copy.matrix(), made.matrix())
        assert (copy.rows, copy.cols, copy.rim_mm) == (ROWS, COLS, RIM_MM)
        assert (copy.pitch_mm, copy.thickness_mm, copy.poisson_ratio) == (PITCH_MM, THICKNESS_MM, NU)
    # Four bytes for each pair of components of each cell and each marker of a quarter.
    size = (tmp_path / "gel.compliance").stat().st_size
    assert size < 9 * 4 * (ROWS + 1) // 2 * (COLS + 1) // 2 * ROWS * COLS + 100
    (tmp_path / "cut").write_bytes((tmp_path / "gel.compliance").read_bytes()[:-9])
    with pytest.raises(gs.ContactError, match="damaged or cut off"):
        gs.Compliance.load(tmp_path / "cut")


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (
            {"thickness_mm": 2.1},
            "force.thickness_mm is 2.1, but the compliance matrix is of a gel where it is 2",
        ),
        ({"poisson_ratio": 0.48}, "force.poisson_ratio is 0.48, but"),
        ({"rim_mm": 1.0}, "force.rim_mm is 1, but the compliance matrix is of a gel where it is 1.5"),
    ],
)
def test_a_matrix_of_another_gel_is_refused(settings: dict[str, Any], text: str) -> None:
    with pytest.raises(gs.ContactError, match=text):
        estimator(narrow(), **settings)


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("rows", 1, "rows is 1; valid is 2 to 64"),
        ("pitch_mm", 2.1, "pitch_mm is 2.1; valid is a fiftieth of the thickness to it"),
        ("poisson_ratio", 0.5, "poisson_ratio is 0.5; valid is 0 to 0.4999"),
        ("thickness_mm", float("nan"), "thickness_mm is nan"),
        ("rim_mm", (1.0, 30.0), "rim_mm along columns is 30"),
        ("rim_mm", (1.0, 1.0, 1.0), "rim_mm has 3 numbers"),
        ("elements_per_pitch", 5, "elements_per_pitch is 5; valid is 1 to 4"),
    ],
)
def test_a_number_out_of_range_is_refused(name: str, value: Any, text: str) -> None:
    gel = {"rows": 3, "cols": 3, "pitch_mm": 1.0, "thickness_mm": 2.0, "rim_mm": 1.0}
    with pytest.raises(gs.ParamsError, match=text):
        compute_compliance(**{**gel, name: value})


def test_without_scipy_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "scipy"]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(ModuleNotFoundError, match=r"compute_compliance needs scipy.*gelstereo\[fem\]"):
        compute_compliance(rows=3, cols=3, pitch_mm=1.0, thickness_mm=2.0, rim_mm=1.0)


def of_layer(
    rows: int, cols: int, pitch_mm: float, thickness_mm: float, poisson_ratio: float
) -> gs.Compliance:
    """The exact layer as a matrix. By reciprocity, motion of a marker under the load of a cell is that of the
    cell under a load at the marker.
    """
    layer = gs.LayerContact(
        thickness_mm=thickness_mm, poisson_ratio=poisson_ratio, rows=rows, cols=cols, cell_mm=pitch_mm
    )
    quarter = ((rows + 1) // 2, (cols + 1) // 2)
    motion_mm = np.empty((*quarter, rows, cols, 3, 3))
    for row, col, component in np.ndindex(*quarter, 3):
        load = np.zeros((rows, cols, 3))
        load[row, col, component] = 1.0
        moved = layer.load(load[..., 0], load[..., 1:]).motion_mm[..., [2, 0, 1]]
        motion_mm[row, col, :, :, component] = moved
    return gs.Compliance(
        motion_mm,
        rows=rows,
        cols=cols,
        pitch_mm=pitch_mm,
        thickness_mm=thickness_mm,
        poisson_ratio=poisson_ratio,
        rim_mm=(9.0, 9.0),
    )


def test_a_pipeline_takes_a_matrix() -> None:
    """With that of the layer, the wrench is that of the layer. A matrix of another lattice is refused."""
    scene = gs.Scene().replace(
        indenter={"kind": "sphere", "radius_mm": 4.0}, effects={"elastic_layer": {"young_kpa": 120.0}}
    )
    sensor, pose = gs.Simulator(scene), np.eye(4)
    pose[:3, 3] = 4.0, 0.0, 40.0
    images = [sensor[0], sensor.press(sensor.pressed(pose, 0.8), shear_mm=(0.1, 0.0), frame=1)]
    settings = {"method": "ridge", "thickness_mm": 5.0, "young_kpa": 120.0}
    pressing = []
    for compliance, stiffening in ((None, 0.0), (of_layer(25, 25, 0.9, 5.0, 0.48), 0.0), (None, 0.3)):
        params = gs.Params.preset("fast").replace(force={**settings, "stiffening": stiffening})
        pipeline = gs.Pipeline(scene.rig, params, compliance=compliance)
        frames = [pipeline.process(pair.left, pair.right) for pair in images]
        wrench = frames[1].wrench
        assert wrench is not None
        pressing.append(wrench.force_n)
    assert np.linalg.norm(pressing[1] - pressing[0]) < 0.01 * np.linalg.norm(pressing[0])
    # Stiffer by three tenths of the strain.
    strain = frames[1].indentation_mm[frames[1].patch].max() / 5.0
    assert np.allclose(pressing[2], (1.0 + 0.3 * strain) * pressing[0], rtol=2e-3)
    params = gs.Params.preset("fast").replace(force=settings)
    narrow_one = gs.Pipeline(scene.rig, params, compliance=of_layer(5, 5, 0.9, 5.0, 0.48))
    with pytest.raises(gs.ContactError, match="the number of columns is 25, but the compliance matrix is of"):
        narrow_one.process(images[0].left, images[0].right)
    with pytest.raises(gs.ContactError, match=r"force\.thickness_mm is 5, but the compliance"):
        gs.Pipeline(scene.rig, params, compliance=narrow())
