"""Supports that hold both sides of a curved interface along its rims."""

import numpy as np
import pytest
from dolfinx import fem
from lame_rings import Mixed, quarters
from sampling import longer

import dolfinx_llm as llm

LAWS = {"frictionless": llm.Frictionless(), "friction": llm.Coulomb(0.2)}
HEX, TET = ("hex", (0.3, 0.2)), ("tet", (0.3, 0.2))
OF_ORDERS = [
    longer(*HEX, (1, 1)), longer(*HEX, (1, 2)), longer(*HEX, (2, 1)), longer(*HEX, (2, 2)),
    (*TET, (1, 1)), longer(*TET, (1, 2)), longer(*TET, (2, 1)), longer(*TET, (2, 2)),
]  # fmt: skip


class Clamped(Mixed):
    """Both tubes held at both ends, or moved along there as given."""

    ends, swap = (0.0, 0.0), False

    def given(self, meshes):
        F, us, bcs, sides = super().given(meshes)
        for u in us:
            V = u.function_space
            for level, way in enumerate(self.ends):
                value = fem.Function(V)
                value.interpolate(lambda x, way=way: np.stack([0 * x[0], 0 * x[0], 0 * x[0] + way]))
                at = lambda x, level=level: np.isclose(x[2], level)  # noqa: E731
                bcs.append(fem.dirichletbc(value, fem.locate_dofs_geometrical(V, at)))
        return F, us, bcs, sides[::-1] if self.swap else sides


def check(problems, pressure):
    """Both forms come to the same state soon, but for how nodes at the rims, whose forces are the
    supports', share them; all balance, and none are multiples of the pressure."""
    forces = []
    for problem, most in zip(problems, (12, 25), strict=True):
        problem.solve()
        assert len(problem.history) <= most
        (result,) = problem.results
        forces.append(np.concatenate([side.force for side in result.sides]))
        first, second = (side.force.sum(axis=0) for side in result.sides)
        assert np.abs(first + second).max() <= 1e-10 * np.abs(forces[-1]).max()
        assert np.abs(result.pressure).max() <= pressure
    inner = off_the_rims(np.concatenate([side.x for side in result.sides]))
    differs = np.abs(forces[0] - forces[1])[inner]
    assert differs.max() <= 1e-9 * np.abs(forces[0][inner]).max()


def off_the_rims(x):
    return (x[:, 2] > 1e-9) & (x[:, 2] < 1.0 - 1e-9)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("kind", "sizes", "orders"), OF_ORDERS)
def test_held_at_both_ends(kind, sizes, orders, law):
    """Forces at the rims are the supports'. Frame nodes there ran away: 93 iterations, and forces
    of 2,000 times the pressure, without a word."""
    meshes = quarters(kind, sizes, orders)
    make = [Clamped(orders).linear(meshes, LAWS[law], form) for form in ("saddle", "condensed")]
    check(make, 25.0 * Mixed(orders).pressure(1.5))


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("kind", "sizes", "orders"), [
    (*TET, (1, 1)), longer(*TET, (2, 2)), longer(*HEX, (1, 1)), longer(*HEX, (2, 2)),
])  # fmt: skip
def test_cones_whose_rims_move(kind, sizes, orders, law):
    """Rims lie between each other's chords, and supports move them along the cone: "the solve
    failed", or, of second order, forces 5,000 times too large without a word."""
    meshes = quarters(kind, sizes, orders)
    for domain, _ in meshes:
        domain.geometry.x[:, :2] *= 1.0 + 0.3 * domain.geometry.x[:, 2:]
    exact = Clamped(orders)
    exact.ends = 0.0, -0.01
    make = []
    for form in ("saddle", "condensed"):
        exact.orders = list(orders)
        make.append(exact.linear(meshes, LAWS[law], form))
    check(make, 25.0 * exact.pressure(1.5))
    exact.orders, exact.swap = list(orders), True
    swapped = exact.linear(meshes, LAWS[law], "saddle")
    swapped.solve()
    for one, other in zip(make[0].results[0].sides, swapped.results[0].sides[::-1], strict=True):
        inner = off_the_rims(one.x)
        size = np.abs(one.force[inner]).max()
        assert np.abs(one.force - other.force)[inner].max() <= 1e-8 * size
