"""Finite elements of `gelstereo_bench.reports.block`: laws that hold for any mesh."""

from __future__ import annotations

import numpy as np
import pytest

from gelstereo_bench.reports.block import Block, compliance, stiffness


def block() -> Block:
    rng = np.random.default_rng(0)
    made = Block.of(4.0, rng.uniform(0.0, 0.5, (5, 5)), 1.0, 1.0)
    moved = made.nodes_mm + rng.uniform(-0.05, 0.05, made.nodes_mm.shape)
    return Block(moved, made.cells, made.fixed, made.markers, made.depths_mm)


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.495])
def test_rigid_motion_needs_no_force(poisson_ratio: float) -> None:
    made = block()
    matrix = stiffness(made.nodes_mm, made.cells, poisson_ratio)
    turn = np.cross([0.1, -0.2, 0.3], made.nodes_mm) + [1.0, 2.0, 3.0]
    assert np.abs(matrix @ turn.ravel()).max() < 1e-9 * np.abs(matrix).max()
    assert abs(matrix - matrix.T).max() < 1e-12 * np.abs(matrix).max()


def test_a_homogeneous_strain_is_in_equilibrium_within_the_mesh() -> None:
    made = block()
    strain = np.array([[0.1, 0.05, 0.0], [0.02, -0.2, 0.1], [0.3, 0.0, 0.15]])
    forces = (stiffness(made.nodes_mm, made.cells, 0.45) @ (made.nodes_mm @ strain.T).ravel()).reshape(-1, 3)
    count = np.bincount(made.cells.ravel(), minlength=len(made.nodes_mm))
    # Nodes within the mesh belong to eight elements.
    assert np.abs(forces[count == 8]).max() < 1e-11 and np.abs(forces).max() > 0.1


def test_a_uniaxial_bar_has_youngs_modulus() -> None:
    made = Block.of(3.0, np.zeros((4, 4)), 1.0, 1.0)
    ratio = 0.4
    matrix = stiffness(made.nodes_mm, made.cells, ratio)
    stretch = made.nodes_mm * [-ratio, -ratio, 1.0]
    forces = (matrix @ stretch.ravel()).reshape(-1, 3)
    top = made.nodes_mm[:, 2] > 2.999
    side = made.nodes_mm[:, 0].max() - made.nodes_mm[:, 0].min()
    # Young's modulus is 2 (1 + ratio) for a shear modulus of 1.
    assert forces[top, 2].sum() == pytest.approx(2.0 * (1.0 + ratio) * side**2, rel=1e-12)
    assert np.abs(forces[:, :2]).max() < 1e-12


def test_compliances_are_symmetric_and_fall_with_depth() -> None:
    made = Block.of(4.0, np.zeros((5, 5)), 1.0, 1.0)
    found = compliance(made)
    np.testing.assert_allclose(found[0], found[0].T, atol=1e-12)
    middle = 3 * 12 + 2
    sinking = found[:, middle, middle]
    assert (np.diff(sinking) < 0.0).all() and sinking[-1] > 0.0
