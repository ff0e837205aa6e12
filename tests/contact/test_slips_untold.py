"""Slips along obstacles that a step of the iteration does not tell."""

import numpy as np
import pytest
import scenes
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.contact.search.gross_slip import slide
from dolfinx_llm.forms.step import StepResult


def test_pairs_without_friction_slip_as_bodies_do():
    """Where a pair presses in a step that has no friction for it nothing tells its slip, which
    was 1e12 times the motion; a scene with three obstacles took 94 iterations instead of 26."""
    sections = (scenes.grid(2, 2),)
    domain, tags = scenes.stacked(MPI.COMM_SELF, sections, (0.0, 1.0))
    V = compat.function_space(domain, shape=(3,))
    bcs = scenes.hold(V, [(k, scenes.on(2, 1.0)) for k in range(3)])
    floor = llm.RigidPlane((0, 0, 0), (0, 0, 1))
    interface = llm.Interface(tags, (1, floor), law=llm.Coulomb(0.3))
    problem = scenes.elastic_problem([V], bcs, [interface])
    problem.solve()
    equations = problem.method.iteration.equations
    (state,) = equations.states
    rows, kappa = state.nodes.rows, state.nodes.kappa
    position = np.random.default_rng(1).uniform(-1.0, 1.0, equations.n)
    w, active = np.full(equations.m, 0.5), np.zeros(equations.n, dtype=bool)
    w[kappa[:2]], active[rows[2]] = 1e12, True
    none = np.zeros(equations.n)
    step = StepResult(none[:0], none, position, w, none[:0], active, active & False)
    found = slide(equations, step, position, 0)
    v = np.asarray(state.nodes.L @ w[state.nodes.v]).reshape(rows.shape)
    untold = ~active[rows[:, 0]]
    assert np.array_equal(found[kappa[untold]], (position[rows] - v)[untold, :2])
    assert untold.sum() == len(rows) - 1 and (found[kappa[2]] == 0.5).all()


@pytest.mark.parametrize("part", [0.02, 0.1])
def test_block_that_is_dragged_at_once(part):
    """From rest far into slip in one load step: it tilts in the first iterate, pairs that come
    back had stuck where they were, and it tilted again, for 40 and 20 iterations."""
    domain, tags = scenes.stacked(MPI.COMM_SELF, (scenes.grid(4, 4),), (0.0, 0.3))
    V = compat.function_space(domain, shape=(3,))
    drag, still = fem.Constant(domain, 0.0), fem.Constant(domain, 0.0)
    bcs = [
        fem.dirichletbc(c, fem.locate_dofs_topological(V.sub(k), 2, tags.find(2)), V.sub(k))
        for k, c in enumerate((drag, still))
    ]
    load = fem.Constant(domain, -5e-3) * ufl.TestFunction(V)[2]
    L = load * ufl.Measure("ds", domain, subdomain_data=tags)(2)
    floor = llm.RigidPlane((0, 0, 0), (0, 0, 1))
    interface = llm.Interface(tags, (1, floor), law=llm.Coulomb(0.3))
    problem = llm.ContactProblem(scenes.forms(V)[0], L, bcs=bcs, interfaces=[interface])
    problem.solve()
    drag.value = part
    problem.solve()
    assert len(problem.history) <= 12
    assert np.allclose(problem.results[0].resultant, [1.5e-3, 0.0, -5e-3], rtol=0.0, atol=1e-6)
