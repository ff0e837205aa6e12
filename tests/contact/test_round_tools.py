"""A disc that supports move as a whole, finer than the block below it, as a rigid one."""

import numpy as np
import pytest
import round_tools

import dolfinx_llm as llm

pytestmark = pytest.mark.quick
LAWS = {"frictionless": llm.Frictionless(), "friction": llm.Coulomb(0.3)}
STEPS = (0.05, 0.0), (0.05, 0.01), (0.05, 0.05)  # pressed, then dragged up to slip


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("order", [1, 2])
def test_at_finite_deformation(order, law):
    """With a frame of the block's facets elements of second order turned inside out, with
    friction."""
    meshed = round_tools.drawn(0.06, 0.12, order)
    (problem, disc), (_, rigid) = (
        round_tools.solved(meshed, order, LAWS[law], alone, STEPS, finite=True)
        for alone in (False, True)
    )
    for (count, force), (_, expected) in zip(disc, rigid, strict=True):
        assert count <= 8
        assert np.abs(force - expected).max() <= 0.006 * np.linalg.norm(expected)
    assert problem.results[0].pressure.min() >= -1e-9 * problem.results[0].pressure.max()


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("order", [1, 2])
def test_at_small_deformation(order, law):
    """Facets of the disc lie inside it, and normals are those of the block."""
    meshed, found = round_tools.drawn(0.06, 0.12, order), []
    for form, most in (("saddle", 8), ("condensed", 16)):
        problem, disc = round_tools.solved(meshed, order, LAWS[law], False, STEPS, form)
        assert max(count for count, _ in disc) <= most
        assert problem.results[0].pressure.min() >= -1e-9 * problem.results[0].pressure.max()
        found.append(np.array([force for _, force in disc]))
    assert np.abs(found[0] - found[1]).max() <= 1e-8 * np.abs(found[0]).max()
    _, [(_, rigid)] = round_tools.solved(meshed, order, LAWS[law], True, STEPS[:1])
    assert np.abs(found[0][0] - rigid).max() <= 0.03 * np.linalg.norm(rigid)
