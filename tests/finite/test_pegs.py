"""A peg that is pressed into a bore with a hundredth of interference, from before its edge."""

import numpy as np
import pytest
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem
from finite_patch import lame, residual
from mpi4py import MPI
from sampling import longer
from scene_oracle import load

import dolfinx_llm as llm
from dolfinx_llm import compat

pytestmark = pytest.mark.quick

HALF, NOSE = 0.505, 0.25  # of the peg: half its width, where the bore's is 0.5; length of its taper


def tapered(x):
    """Its lower flank, that rises towards the front at x = -0.1."""
    rise = 0.085 * np.clip((x[:, 0] + 0.1 + NOSE) / NOSE, 0.0, 1.0)
    return np.column_stack([x[:, 0], 0.5 - (0.5 - x[:, 1]) * (1.0 - rise / HALF)])


class Peg:
    """Half of it: its middle at y = 0.5 slides, its end at x = -1.3 is pushed; order 1 or 2."""

    def __init__(self, order, mu):
        comm, law = MPI.COMM_SELF, llm.Coulomb(mu) if mu else llm.Frictionless()
        low, high = (-1.3, 0.5 - HALF), (-0.1, 0.5)
        peg = rectangle(comm, (8, 3), low, high, "triangle", move=tapered)
        bore = rectangle(comm, (8, 4), (0.0, -0.5), (1.0, 0.0), "triangle")
        V = [compat.function_space(d, degree=order, shape=(2,)) for d, _ in (peg, bore)]
        self.u = [fem.Function(space) for space in V]
        self.pushed, still = fem.Function(V[0]), fem.Function(V[1])
        middle = fem.locate_dofs_topological(V[0].sub(1), 1, peg[1].find(ABOVE))
        end = fem.locate_dofs_geometrical(V[0], lambda p: np.isclose(p[0], low[0]))
        base = fem.locate_dofs_geometrical(V[1], lambda p: np.isclose(p[1], -0.5))
        bcs = [
            fem.dirichletbc(0.0, middle, V[0].sub(1)),
            fem.dirichletbc(self.pushed, end),
            fem.dirichletbc(still, base),
        ]
        young = zip(self.u, (20.0, 10.0), strict=True)
        F = [residual(u, *lame(E, 0.3), order) for u, E in young]
        self.bore = fem.form(F[1]), base
        sides = (peg[1], BELOW), (bore[1], ABOVE)
        interface = llm.Interface(None, sides, law=law)
        self.problem = llm.NonlinearContactProblem(F, self.u, bcs=bcs, interfaces=[interface])

    def push(self, way):
        """Iterations to there, and the force of the bore's support, by its residual alone."""
        self.pushed.x.array[::2] = way
        self.problem.solve()
        form, base = self.bore
        return len(self.problem.history), load(form).reshape(-1, 2)[base].sum(axis=0)


@pytest.mark.parametrize("mu", [longer(0.0), 0.3])
def test_a_second_order_peg(mu):
    """Nodes of the bore far behind its flank lie where facets amid the flank go on straight, since
    the first ones bend away: they do not touch these. A step did not end within a minute."""
    found = {}
    for order in (1, 2):
        peg = Peg(order, mu)
        peg.push(0.06)
        assert peg.problem.history[-1]["active"] == 0  # before the edge
        found[order] = [peg.push(way) for way in (0.45, 0.9)]
        total = peg.problem.results[0].resultant
        assert abs(total + found[order][-1][1]).max() <= 1e-9 * abs(total).max()
    assert max(iterations for iterations, _ in found[2]) <= 12
    coarse, fine = (np.array([force for _, force in found[k]])[:, 1] for k in (1, 2))
    assert fine == pytest.approx(coarse, rel=0.15)  # of the normal force
