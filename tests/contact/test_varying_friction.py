"""Rows of laws by hand values and finite differences; friction that varies, and cohesion."""

import numpy as np
import pytest
from contact_scenes import Pressed
from dolfinx import fem
from test_contact import blocks, down, pressed

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.laws.coulomb import newton_rows, projection_miss
from dolfinx_llm.laws.rows import CLOSED, OPEN, SLIP, STICK


def test_states_by_hand():
    T = np.array([[1.0, 0.0], [3.0, 4.0], [0.0, 0.0]])
    rows = newton_rows(T, np.array([2.0, 5.0 - 1e-9, -1.0]), np.zeros((3, 2)), np.ones(3))
    assert rows.status.tolist() == [STICK, SLIP, OPEN]
    np.testing.assert_array_equal(rows.C_T[2], np.eye(2))  # T = 0
    np.testing.assert_array_equal(rows.C_jump[0], np.eye(2))  # no slip
    assert not rows.rhs[[0, 2]].any() and not rows.C_T[0].any()
    assert projection_miss(T, np.array([2.0, 2.5, 0.0]), np.zeros((3, 2)), np.ones(3)) == (
        pytest.approx([0.0, 2.5, 0.0])
    )


@pytest.mark.parametrize("seed", [3, 5, 8])
def test_slip_rows_are_the_derivative(seed):
    """On the cone, where the stabilised rows are Newton's own: C_T dT + C_δ dδ + C_N ds is the
    derivative of T - s z / |z|, along any change."""
    rng = np.random.default_rng(seed)
    c, delta = 3.0, rng.standard_normal((4, 2))
    s = rng.uniform(1.0, 2.0, 4)
    T = s[:, None] * delta / np.linalg.norm(delta, axis=1)[:, None]
    rows = newton_rows(T, s, delta, np.full(4, c))
    assert (rows.status == SLIP).all()

    def residual(T, s, delta):
        z = T + c * delta
        return T - s[:, None] * z / np.linalg.norm(z, axis=1)[:, None]

    dT, ds, dd = rng.standard_normal((4, 2)), rng.standard_normal(4), rng.standard_normal((4, 2))
    h = 1e-6
    ends = [residual(T + k * h * dT, s + k * h * ds, delta + k * h * dd) for k in (1, -1)]
    found = sum(np.einsum("nij,nj->ni", C, d) for C, d in ((rows.C_T, dT), (rows.C_jump, dd))) + (
        rows.C_N * ds[:, None]
    )
    np.testing.assert_allclose(found, (ends[0] - ends[1]) / (2 * h), atol=1e-7)


def dragged(law):
    scene = pressed(law)
    scene.move(down(0.03))
    scene.move(down(0.03, drag=0.05), increments=2)
    return scene.problem.results[0]


def test_friction_that_varies():
    """Gross slip: at every node of the frame μ(x) N, with μ as a function or as an array."""

    def mu(x):
        return 0.2 + 0.1 * x[:, 0]

    result = dragged(llm.Coulomb(mu))
    N, T = result.frame_force, np.linalg.norm(result.frame_friction, axis=1)
    assert (result.frame_status == SLIP).all()
    np.testing.assert_allclose(T, mu(result.x) * N, atol=1e-9 * N.max())
    again = dragged(llm.Coulomb(mu(result.x)))
    np.testing.assert_allclose(again.frame_friction, result.frame_friction, atol=1e-10 * N.max())


def sliding(law_of):
    """Gross slip under a law made for the upper or lower mesh, as ``law_of`` makes it."""
    bodies = blocks()
    law = law_of([domain for domain, _ in bodies])
    scene = Pressed(bodies, law, lambda p: p[1] > 2.0 - 1e-9, lambda p: p[1] < 1e-9)
    scene.move(down(0.03))
    scene.move(down(0.03, drag=0.05), increments=2)
    return scene.problem.results[0]


@pytest.mark.parametrize("side", [0, 1])
def test_friction_as_a_function(side):
    """A Function of either mesh, linear in position: as the same as a function of positions, where
    the frame reaches beyond the body with the values at its edge."""
    half = (1.0, 0.6)[side]

    def mu(x):
        return 0.2 + 0.1 * np.clip(x[0], -half, half)

    def law_of(meshes):
        V = compat.function_space(meshes[side], "Lagrange", 2 - side)
        given = fem.Function(V)
        given.interpolate(mu)
        return llm.Coulomb(given, cohesion=given)

    result = sliding(law_of)
    known = sliding(lambda _: llm.Coulomb(lambda x: mu(x.T), cohesion=lambda x: mu(x.T)))
    largest = known.frame_force.max()
    np.testing.assert_allclose(result.frame_friction, known.frame_friction, atol=1e-9 * largest)
    assert np.ptp(known.frame_friction[:, 0] / known.frame_force) > 0.03


def test_friction_as_a_constant():
    """A Constant counts as its value."""
    result = sliding(
        lambda m: llm.Coulomb(fem.Constant(m[0], 0.25), cohesion=fem.Constant(m[1], 2.0))
    )
    known = sliding(lambda _: llm.Coulomb(0.25, cohesion=2.0))
    np.testing.assert_array_equal(result.frame_friction, known.frame_friction)


def test_a_function_of_no_side_is_refused():
    def law_of(_):
        return llm.Coulomb(fem.Function(compat.function_space(blocks()[0][0])))

    with pytest.raises(llm.ContactInputError, match="neither side"):
        sliding(law_of)

    def vector(meshes):
        return llm.Coulomb(fem.Function(compat.function_space(meshes[0], shape=(2,))))

    with pytest.raises(llm.ContactInputError, match="scalar"):
        sliding(vector)


def test_part_without_friction():
    """Where μ vanishes contact is closed without friction."""
    result = dragged(llm.Coulomb(lambda x: np.where(x[:, 0] > 0.0, 0.3, 0.0)))
    smooth = result.x[:, 0] <= 0.0
    N = result.frame_force.max()
    assert set(result.frame_status[smooth]) == {CLOSED}
    assert np.abs(result.frame_friction[smooth]).max() <= 1e-10 * N


def test_cohesion():
    """|T| = μ N + cohesion times area in gross slip; alone it is a traction of its own."""
    for mu, cohesion in ((0.2, 5.0), (0.0, 8.0)):
        result = dragged(llm.Coulomb(mu, cohesion=cohesion))
        N, T = result.frame_force, np.linalg.norm(result.frame_friction, axis=1)
        assert (result.frame_status == SLIP).all()
        expected = mu * N + cohesion * result.frame_area
        np.testing.assert_allclose(T, expected, atol=1e-9 * N.max())


def test_bad_values():
    with pytest.raises(llm.ContactInputError, match="cohesion=-1"):
        llm.Coulomb(0.1, cohesion=-1.0)
    with pytest.raises(llm.ContactInputError, match="at least 0"):
        llm.Coulomb(np.array([0.1, -0.2]))
    with pytest.raises(llm.ContactInputError, match="nodes"):
        pressed(llm.Coulomb(np.array([0.1, 0.2]))).move(down(0.01))
