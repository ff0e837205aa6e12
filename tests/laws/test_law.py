"""The base of laws: rows by hand values and finite differences, flags, and what is refused."""

from dataclasses import replace

import numpy as np
import own_law
import pytest

import dolfinx_llm as llm
from dolfinx_llm.laws.answers import rows_of
from dolfinx_llm.laws.rows import CLOSED, STICK

pytestmark = pytest.mark.quick


def nodes_of(law, jump, force=None, N=None, before=None):
    """Nodes of area 2 with some jumps (k, q)."""
    jump = np.asarray(jump, dtype=float)
    k = len(jump)
    nodes = llm.LawNodes(
        x=np.zeros((k, 3)),
        area=np.full(k, 2.0),
        force=np.zeros_like(jump) if force is None else np.asarray(force, dtype=float),
        N=np.zeros(k) if N is None else np.asarray(N, dtype=float),
        jump=jump,
        before=np.zeros_like(jump) if before is None else np.asarray(before, dtype=float),
        c=np.ones(k),
        status=np.full(k, STICK),
    )
    return replace(nodes, history=law.start(nodes))


class Spring(llm.Law):
    """T = 3 area (jump + jump³), each component by itself."""

    slips, gives = True, True

    def force(self, nodes):
        a = 3.0 * nodes.area[:, None]
        return a * (nodes.jump + nodes.jump**3), a * (1.0 + 3.0 * nodes.jump**2)


def test_springs_by_hand():
    nodes = nodes_of(Spring(), [[1.0, 0.0, -2.0]], before=[[0.5, 0.0, 0.0]])
    rows = Spring().rows(nodes)
    assert rows.status.tolist() == [STICK]
    np.testing.assert_array_equal(rows.C_T[0], np.eye(3))
    np.testing.assert_array_equal(rows.C_jump[0], -6.0 * np.diag([4.0, 1.0, 13.0]))
    # T = 6 (jump + jump³) there: 12, 0, -60; rows are in the jump of the step, 0.5, 0, -2.
    np.testing.assert_allclose(rows.rhs[0], [12.0 - 24.0 * 0.5, 0.0, -60.0 + 78.0 * 2.0])
    assert Spring().miss(nodes) == pytest.approx(np.hypot(12.0, 60.0))
    lawful = replace(nodes, force=np.array([[12.0, 0.0, -60.0]]))
    assert Spring().miss(lawful) == pytest.approx(0.0, abs=1e-13)


def test_layer_by_hand():
    """o = log(1 + T) in units of 1: at T = 1 it is log 2, its derivative 1 / 2."""
    nodes = nodes_of(Spring(), [[0.25]], force=[[1.0]], before=[[0.1]])
    rows = llm.LawRows.layer(nodes, np.log([[2.0]]), np.array([[0.5]]))
    assert rows.status.tolist() == [CLOSED]
    # T - 2 o = 1 - 2 log 2 on the tangent; o is 0.1 and what the step adds.
    assert rows.C_T.item() == 1.0 and rows.C_jump.item() == -2.0
    assert rows.rhs.item() == pytest.approx(1.0 - 2.0 * np.log(2.0) + 0.2)
    assert rows.left(nodes).item() == pytest.approx(2.0 * (np.log(2.0) - 0.25))
    rigid = llm.LawRows.layer(nodes, np.array([[0.3]]), np.zeros((1, 1)))
    # The jump is 0.3, whatever the force: 0.2 in this step.
    assert rigid.C_T.item() == 0.0
    assert rigid.rhs.item() / rigid.C_jump.item() == pytest.approx(0.2)


def test_cohesion_is_of_nodes_that_press():
    """Not of open ones, whose forces are rounding: their neighbours had borne it for them."""
    law = llm.Coulomb(0.5, cohesion=3.0)
    nodes = nodes_of(law, np.zeros((4, 1)), N=[2.0, 1e-15, -1e-15, 1e-3])
    nodes = replace(nodes, given=law.begin_step(nodes))
    np.testing.assert_allclose(law.strength(nodes), [7.0, 0.0, 0.0, 6.0 + 5e-4], atol=1e-12)


def differences(law, nodes, h=1e-7):
    """Greatest difference between the rows' slopes and those of what they leave."""
    rng = np.random.default_rng(7)
    dj, dT = rng.standard_normal((2, *nodes.jump.shape))
    dN = dT[:, -1] if law.gives else rng.standard_normal(len(dT))

    def left(t):
        at = replace(nodes, jump=nodes.jump + t * dj, force=nodes.force + t * dT,
                     N=nodes.N + t * dN)  # fmt: skip
        return law.rows(at).left(at)

    rows = law.rows(nodes)
    slope = np.einsum("nij,nj->ni", rows.C_T, dT) + np.einsum("nij,nj->ni", rows.C_jump, dj)
    slope = slope + rows.C_N * ((1.0 if rows.weight is None else rows.weight) * dN)[:, None]
    return np.abs((left(h) - left(-h)) / (2 * h) - slope).max() / np.abs(slope).max()


@pytest.mark.parametrize("q", [2, 3])
@pytest.mark.parametrize("size", [0.5, 3.0, 60.0])  # below first, falling, beyond last
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rows_of_the_glue_are_the_derivative(q, size, sign):
    law = own_law.Glue()
    jump = law.first * size * np.random.default_rng(11).uniform(0.4, 1.0, (6, q))
    jump[:, -1] *= sign
    nodes = nodes_of(law, jump)
    assert differences(law, nodes, h=1e-9) <= 1e-5
    T = -law.rows(nodes).left(nodes)  # forces of the law
    if sign > 0.0:
        np.testing.assert_allclose(T[:, -1], law.k * 2.0 * jump[:, -1])
    elif size == 60.0:
        assert np.abs(T).max() <= 1e-12


def test_the_glue_remembers():
    """Unloading is elastic, with what is left of the stiffness."""
    law, far = own_law.Glue(), 0.004
    apart = nodes_of(law, [[0.0, -far]])
    kept = law.end_step(apart)
    assert kept["largest"].tolist() == [far]
    back = replace(apart, jump=np.array([[0.0, -0.001]]), history=kept)
    left = law.first * (law.last - far) / (far * (law.last - law.first))
    T = law.rows(replace(back, before=back.jump)).rhs
    assert T[0, -1] == pytest.approx(-law.k * 2.0 * left * 0.001)
    assert law.rows(back).holds.tolist() == [True]
    gone = replace(apart, history={"largest": np.array([law.last])})
    assert law.rows(gone).holds.tolist() == [False]


def test_rows_of_the_soft_layer_are_the_derivative():
    law = own_law.Soft()
    T = np.random.default_rng(5).uniform(0.1, 30.0, (5, 1))
    nodes = nodes_of(law, law.h * np.log1p(T / 2.0 / law.p0), force=T, N=T[:, 0])
    assert law.miss(nodes).max() <= 1e-12 * T.max()
    # T - o / s with s the compliance: o grows by s area for each unit of pressure.
    assert np.allclose(
        nodes.area / law.rows(nodes).C_jump[:, 0, 0], -law.h / (law.p0 + T[:, 0] / 2)
    )


def test_the_soft_layer_goes_on_where_iterates_pull():
    """What rows at one force say of another near by is what rows say there, up to the square."""
    law, step = own_law.Soft(), 1e-3
    at = np.array([[-5.0], [-1.0], [-0.1], [0.1], [3.0]])

    def jump(T, of):
        rows = law.rows(nodes_of(law, np.zeros((len(at), 1)), force=T, N=T[:, 0]))
        return (rows.rhs - rows.C_T[:, 0] * of) / rows.C_jump[:, 0]

    told, there = jump(at, at + step), jump(at + step, at + step)
    assert np.abs(told - there).max() <= law.h / law.p0**2 * step**2
    assert np.abs(jump(at, at) - there).min() >= 0.05 * law.h / law.p0 * step


@pytest.mark.parametrize(
    "flags",
    [{"components": "up"}, {"components": "normal", "slips": True}, {"components": "cartesian"},
     {"components": "normal", "opens": False}],
)  # fmt: skip
def test_flags_that_do_not_fit_are_refused(flags):
    law = type("Odd", (llm.Law,), flags)()
    with pytest.raises(llm.ContactInputError, match="components="):
        law.check()


@pytest.mark.parametrize(
    "name, value", [("rhs", np.zeros((2, 1))), ("C_T", np.full((2, 2, 2), np.nan))]
)
def test_rows_that_do_not_fit_are_refused(name, value):
    class Mine(Spring):
        def rows(self, nodes):
            return replace(super().rows(nodes), **{name: value})

    nodes = nodes_of(Mine(), np.zeros((2, 2)))
    with pytest.raises(llm.ContactError, match=f"rows of the law Mine: {name} "):
        rows_of(Mine(), nodes)


def test_rows_get_the_size_of_the_bodies_stiffness():
    """Those of nodes that supports hold are 1e11 times it; the equations stay."""
    law, c = Spring(), np.array([2.0, 3.0])
    nodes = nodes_of(law, [[1.0, 0.0], [0.5, -2.0]])
    rows = law.rows(nodes)
    big = np.array([1.0, 1e11])
    grown = replace(
        rows, C_T=big[:, None, None] * rows.C_T, C_jump=big[:, None, None] * rows.C_jump,
        rhs=big[:, None] * rows.rhs,
    )  # fmt: skip
    scaled = grown.scaled(c)
    assert scaled.C_T[0].tolist() == rows.C_T[0].tolist()
    assert np.abs(scaled.C_jump[1]).max() == pytest.approx(c[1])
    left, was = scaled.left(nodes)[1], rows.left(nodes)[1]
    np.testing.assert_allclose(left / left[0], was / was[0], rtol=1e-12)


def test_a_law_without_rows_says_so():
    with pytest.raises(NotImplementedError, match="neither force nor rows"):
        llm.Law().rows(nodes_of(llm.Law(), np.zeros((1, 0))))
