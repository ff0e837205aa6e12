"""Slips along obstacles that a step of the iteration does not tell."""

import numpy as np
import scenes
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
    w[kappa[:3]], active[rows[2]] = 1e12, True
    none = np.zeros(equations.n)
    step = StepResult(none[:0], none, position, w, none[:0], active, active & False)
    found = slide(equations, step, position, 0)
    v = np.asarray(state.nodes.L @ w[state.nodes.v]).reshape(rows.shape)
    assert np.array_equal(found[kappa[:2]], (position[rows] - v)[:2, :2])
    assert (found[kappa[2]] == 1e12).all() and (found[kappa[3:]] == 0.5).all()
