"""Planes of symmetry, on which supports hold both sides of a curved interface: known forces."""

import numpy as np
import pytest
from lame_rings import Lame, quarters
from sampling import longer

import dolfinx_llm as llm

PLANES = ((0, 0.0), (1, 0.0), (2, 0.0), (2, 1.0))  # axis and level
MESHES = [("hex", (0.3, 0.2)), ("tet", (0.3, 0.2)), longer("tet", (0.2, 0.13))]


def across(side, axis, level):
    """Forces across a plane at the nodes on it, of what pressure does at all."""
    on = np.isclose(side.x[:, axis], level)
    assert on.any()
    return np.abs(side.force[on, axis]) / (side.area[on] * Lame().pressure(1.5))


@pytest.mark.parametrize("solver", ["saddle", "condensed"])
@pytest.mark.parametrize(("kind", "sizes"), MESHES)
def test_friction(kind, sizes, solver):
    """Nodes on the planes at which the law holds bear no friction across them, those of the side
    that carries the frame what rows beside them leave there, less than half of what friction may
    bear. Rows there held what lies beside them, and friction flickered for ever on tetrahedra."""
    problem = Lame().linear(quarters(kind, sizes), llm.Coulomb(0.3), solver)
    problem.solve()
    (result,), p = problem.results, Lame().pressure(1.5)
    assert len(problem.history) <= 8
    assert np.abs(result.pressure - p).max() <= (0.5 if kind == "tet" else 0.05) * p
    law_side = problem.geometries[0].law_side
    for k, side in enumerate(result.sides):
        for axis, level in PLANES:
            assert across(side, axis, level).max() <= (1e-3 if k == law_side else 0.15)


@pytest.mark.parametrize("solver", ["saddle", "condensed"])
@pytest.mark.parametrize(("kind", "sizes"), MESHES)
def test_supports_that_slip(kind, sizes, solver):
    """The planes at both ends of the outer tube move along the inner one, whose do not: all slips,
    and friction is that of the whole pressure."""
    exact = Lame()
    exact.along = 0.01
    problem = exact.linear(quarters(kind, sizes), llm.Coulomb(0.3), solver)
    problem.solve()
    (result,) = problem.results
    assert problem.history[-1]["stick"] == 0 and len(problem.history) <= 40
    for side in result.sides:
        friction = np.abs(side.force[:, 2].sum())
        assert friction == pytest.approx(0.3 * side.normal_force.sum(), rel=5e-3)


@pytest.mark.parametrize(("kind", "sizes"), MESHES)
def test_ties(kind, sizes):
    """Rows of corner nodes, on two planes, reached along one across the other: forces across
    it were up to ten times what the pressure is on tetrahedra."""
    problem = Lame().linear(quarters(kind, sizes), llm.Tied(), "auto")
    problem.solve()
    for side in problem.results[0].sides:
        for level in (0.0, 1.0):
            assert across(side, 2, level).max() <= 0.3


def test_rows_stay_on_planes():
    """Nodes of a plane that lie on the frame's outline are bound to frame nodes on it."""
    problem = Lame().linear(quarters("tet", (0.3, 0.2)), llm.Tied(), "auto")
    (geometry,) = problem.geometries
    for pairs in geometry.pairs:
        for axis, level in PLANES:
            on = np.isclose(pairs.x[:, axis], level)
            beyond = ~np.isclose(geometry.frame.x[:, axis], level)
            assert on.sum() > 3 and abs(pairs.N[on][:, beyond]).max() <= 1e-14
