"""Second-order bodies at finite deformation: exact states, orders, forms, ranks."""

import finite_patch
import numpy as np
import patch2d
import pytest
import second_order_blocks as so
import ufl
from conftest import run_mpi_json
from dolfinx import fem
from mpi4py import MPI
from pressed_scenes import Punch
from sampling import longer
from test_second_order import QUAD, TRI, scene

import dolfinx_llm as llm
from dolfinx_llm.problem import nonlinear_parts

COMM = MPI.COMM_SELF


@pytest.mark.parametrize(
    ("kinds", "order"),
    [longer("hex", (0, 1)), longer("tet", (1, 0)), (("hex", "tet"), (0, 1))],
    ids=str,
)
def test_finite_patch(kinds, order):
    """A punch on a wider foundation, under pressures that follow all that is free: forces of
    constant pressure vanish at corners of 6-node facets, and are negative on some clipped ones."""
    separate = isinstance(kinds, tuple)
    bodies = patch2d.bodies(COMM, kinds, 1, separate, boxes=finite_patch.BOXES[3])
    problem = finite_patch.problem(bodies, order=order, degree=2)
    problem.solve()
    stretch, pressure = finite_patch.errors(problem, finite_patch.stretches(300.0))
    assert stretch < 1e-12 and pressure < 1e-11
    result = problem.results[0]
    for side in result.sides:  # forces of nodes are those of the area that they stand for
        assert np.abs(side.normal_force - 300.0 * side.area).max() < 1e-9 * 300.0
    assert max(h["iteration"] for h in problem.history) <= 7


def test_order():
    """Ties of linear bodies with a smooth answer: between orders 2.5 and 3 in displacement, 1.5 and
    2 in stress, and a hundredth of the errors of first order."""

    def nonlinear(a, L, **chosen):
        u = [fem.Function(V) for V in spaces]
        F = [ufl.action(form, w) - load for form, load, w in zip(a, L, u, strict=True)]
        return llm.NonlinearContactProblem(F, u, **chosen)

    def found(n, degree):
        nonlocal spaces
        spaces, tags = scene((TRI, QUAD), n, degrees=(degree, degree))
        problem = so.manufactured_problem(spaces, tags, field, make=nonlinear)
        return so.errors(problem.solve(), field)

    field, spaces = so.Waves(2), []

    coarse, fine, first = found((8, 12), 2), found((16, 24), 2), found((16, 24), 1)
    assert (np.log2(np.divide(coarse, fine)) >= [2.5, 1.5]).all()
    assert (np.divide(first, fine) >= [100.0, 70.0]).all()


@pytest.mark.parametrize("kind", ["tri", longer("quad"), longer("tet"), longer("hex")])
def test_forms(kind, monkeypatch):
    """A punch under friction, some of whose nodes stick: the same by GMRES as by MUMPS, in
    equilibrium; no pair pulls, and pressures are none either."""
    found = []
    for limit in (10**9, 0):
        monkeypatch.setattr(nonlinear_parts, "FROM_UNKNOWNS", {2: limit, 3: limit})
        punch = Punch(kind, llm.Coulomb(0.3), degree=2)
        found.append((punch.to(down=0.05, along=0.01), punch.problem))
        assert all((h["linear"] > 0) == (limit == 0) for h in punch.problem.history)
    (one, _), (other, _) = found
    for a, b in zip(one.sides, other.sides, strict=True):
        assert np.abs(a.force - b.force).max() < 1e-8 * np.abs(a.force).max()
    assert {1, 2} <= set(one.sides[1].status) and one.pressure.min() >= 0.0
    total = sum(side.force.sum(axis=0) for side in one.sides)
    assert np.abs(total).max() < 1e-10 * np.abs(one.resultant).max()


@pytest.mark.long
@pytest.mark.parametrize("kind", ["quad", "tet"])
def test_two_ranks(kind):
    one, two = (run_mpi_json("finite_ranks.py", n, kind, "second") for n in (1, 2))
    assert max(two["stretch"], two["pressure"]) < 1e-10
    assert np.allclose(one["force"], two["force"], rtol=1e-8, atol=1e-9 * 300.0)
