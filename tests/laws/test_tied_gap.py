"""Ties with a given gap: a bolt cut in its shank and tightened."""

import numpy as np
import pytest
import ufl
from contact_scenes import ABOVE, BELOW, hold_all, rectangle
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM, E = MPI.COMM_SELF, 200.0


def at_interface(u):
    """Along it x and the vertical displacement of a body's nodes."""
    x = u.function_space.tabulate_dof_coordinates()
    at = np.flatnonzero(np.abs(x[:, 1] - 1.5) < 1e-9)
    at = at[np.argsort(x[at, 0])]
    return x[at, 0], u.x.array.reshape(-1, 2)[at, 1]


@pytest.mark.parametrize("solver", ["saddle", "condensed"])
def test_tightened_bolt(solver):
    """Both ends held, ν = 0: stress E d / l everywhere, for every value of the gap, whichever side
    is named first, and by the classical forms, which stay."""
    parts = [
        rectangle(COMM, (3, 4), (0.0, 0.0), (1.0, 1.5), "quadrilateral"),
        rectangle(COMM, (4, 2), (0.0, 1.5), (1.0, 2.5), "triangle"),
    ]
    spaces = [compat.function_space(d, shape=(2,)) for d, _ in parts]
    bcs = hold_all(spaces[0], lambda p: p[1] < 1e-9, lambda p: 0.0 * p)
    bcs += hold_all(spaces[1], lambda p: p[1] > 2.5 - 1e-9, lambda p: 0.0 * p)
    gap = fem.Constant(parts[0][0], 0.0)
    sides = (parts[0][1], ABOVE), (parts[1][1], BELOW)
    for order in (1, -1):
        law = llm.Tied(gap=gap)
        forms, loads = [], []
        for V in spaces:
            u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
            forms.append(E * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx)
            loads.append(ufl.inner(fem.Constant(V.mesh, (0.0, 0.0)), w) * ufl.dx)
        problem = llm.ContactProblem(
            forms,
            loads,
            bcs=bcs,
            interfaces=llm.Interface(None, sides[::order], law=law),
            solver=solver,
        )
        eliminated = llm.classical.Elimination(problem)
        ties = [
            llm.classical.NodeToSegment(problem, slave=slave, components=components)
            for slave, components in ((0, "all"), (1, "normal"))
        ]
        for gap.value in (-0.01, 0.02, 0.0):
            for u in problem.solve() + eliminated.solve():
                stress = E * ufl.grad(u)[1, 1] + E * float(gap.value) / 2.5
                error = fem.assemble_scalar(fem.form(stress**2 * ufl.dx)) ** 0.5
                assert error < 1e-11, error
            assert problem.results[0].pressure == pytest.approx(E * float(gap.value) / 2.5)
            for slave, tie in enumerate(ties):
                lower, upper = (at_interface(u) for u in tie.solve())
                below = (slave == 0) == (order == 1)  # whose nodes are tied
                own, other = (lower, upper) if below else (upper, lower)
                apart = np.interp(own[0], *other) - own[1]
                wanted = gap.value if below else -gap.value
                np.testing.assert_allclose(apart, wanted, atol=1e-14)
    u = fem.Function(spaces[0])
    F = ufl.inner(ufl.grad(u), ufl.grad(ufl.TestFunction(spaces[0]))) * ufl.dx
    tags = parts[0][1]
    with pytest.raises(llm.ContactInputError, match="a given gap is for small deformation"):
        contact = llm.Interface(tags, (ABOVE, BELOW), law=llm.Tied(gap=0.1))
        llm.NonlinearContactProblem(F, u, interfaces=contact)
    with pytest.raises(llm.ContactInputError, match="Tied: gap"):
        llm.Tied(gap=np.ones(3))
    with pytest.raises(llm.ContactInputError, match="Tied: gap"):
        llm.Tied(gap="wide")


def test_gap_where_both_sides_are_held():
    """Refused: it would contradict the supports."""
    parts = [
        rectangle(COMM, (2, 1), (0.0, 0.0), (1.0, 1.0), "quadrilateral"),
        rectangle(COMM, (3, 1), (0.0, 1.0), (1.0, 2.0), "quadrilateral"),
    ]
    spaces = [compat.function_space(d, shape=(2,)) for d, _ in parts]
    bcs = [bc for V in spaces for bc in hold_all(V, lambda p: p[0] < 1e-9, lambda p: 0.0 * p)]
    sides = (parts[0][1], ABOVE), (parts[1][1], BELOW)
    forms, loads = [], []
    for V in spaces:
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        forms.append(ufl.inner(ufl.grad(u), ufl.grad(w)) * ufl.dx)
        loads.append(ufl.inner(fem.Constant(V.mesh, (0.0, 0.0)), w) * ufl.dx)
    contact = llm.Interface(None, sides, law=llm.Tied(gap=0.1))
    with pytest.raises(llm.ContactInputError, match="gaps could contradict them"):
        llm.ContactProblem(forms, loads, bcs=bcs, interfaces=contact).solve()
