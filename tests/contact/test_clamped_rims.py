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

    ends = (0.0, 0.0)

    def given(self, meshes):
        F, us, bcs, sides = super().given(meshes)
        for u in us:
            V = u.function_space
            for level, way in enumerate(self.ends):
                value = fem.Function(V)
                value.interpolate(lambda x, way=way: np.stack([0 * x[0], 0 * x[0], 0 * x[0] + way]))
                at = lambda x, level=level: np.isclose(x[2], level)  # noqa: E731
                bcs.append(fem.dirichletbc(value, fem.locate_dofs_geometrical(V, at)))
        return F, us, bcs, sides


def check(problems, pressure):
    """Both forms come to the same state soon, but for how nodes of both sides that coincide at the
    rims share forces; these balance, and are no multiples of others."""
    forces = []
    for problem, most in zip(problems, (12, 25), strict=True):
        problem.solve()
        assert len(problem.history) <= most
        (result,) = problem.results
        forces.append(np.concatenate([side.force for side in result.sides]))
        first, second = (side.force.sum(axis=0) for side in result.sides)
        assert np.abs(first + second).max() <= 1e-10 * np.abs(forces[-1]).max()
        assert np.abs(result.pressure).max() <= pressure
    z = np.concatenate([side.x[:, 2] for side in result.sides])
    differs = np.abs(forces[0] - forces[1]).max(axis=1) / np.abs(forces[0]).max()
    assert differs.max() <= 1e-5 and differs[(z > 1e-9) & (z < 1.0 - 1e-9)].max() <= 1e-9


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
