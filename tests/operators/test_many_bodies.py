"""Many bodies: what is asked of them must not grow faster than their number."""

import numpy as np
import pytest
import ufl
import wall_scenes as walls
from dolfinx import fem
from mpi4py import MPI
from scipy.sparse import csr_matrix

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.forms.direct import DirectSolver
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.motions import RigidMotions


def chosen(modes):
    """Dofs that hold motions best, one after the other, of all others at once."""
    rest, found = modes.copy(), []
    for _ in range(modes.shape[1]):
        best = int(np.round((rest**2).sum(axis=1), 10).argmax())
        found.append(best)
        d = rest[best]
        rest = rest - np.outer(rest @ d, d) / (d @ d)
    return found


@pytest.mark.parametrize("bodies", [1, 5])
def test_pins_of_single_bodies(bodies):
    """Motions of a body at its own dofs alone, in any order."""
    low = np.stack([2.0 * np.arange(bodies), np.zeros(bodies)], axis=1)
    wall = walls.Wall(MPI.COMM_SELF, np.stack([low, low + 1.0], axis=1), [[4, 3]] * bodies)
    rng = np.random.default_rng(17)
    body = rng.permutation(np.repeat(np.arange(bodies), 3))
    known = Bodies([wall.V])
    label = np.repeat(known.label, 2)
    modes = np.where(label[:, None] == body, rng.standard_normal((len(label), len(body))), 0.0)
    table, none = csr_matrix(modes), csr_matrix((len(body),) * 2)
    rigid = RigidMotions(known, body, np.eye(3), len(body), table, table, none, body)
    found = rigid.pins(len(body))
    assert sorted(found) == sorted(chosen(modes))
    assert np.linalg.matrix_rank(modes[found]) == 3 * bodies


def stack(n):
    """Solved problem of n blocks that stand on each other, frictionless, on weak springs."""
    low = np.stack([np.zeros(n), np.arange(n)], axis=1)
    counts = np.tile([[2, 1], [3, 2]], (n, 1))[:n]
    wall = walls.Wall(MPI.COMM_SELF, np.stack([low, low + 1.0], axis=1), counts)
    V = wall.V
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    strain = lambda w: ufl.sym(ufl.grad(w))  # noqa: E731
    a = (1e3 * ufl.inner(strain(u), strain(v)) + 1e-2 * ufl.inner(u, v)) * ufl.dx
    L = ufl.inner(fem.Constant(wall.domain, (0.0, -1e-3)), v) * ufl.dx
    foot = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[1], 0.0))
    bcs = [fem.dirichletbc(np.zeros(2), foot, V)]
    interfaces = llm.find_interfaces(None, V, law=llm.Frictionless())
    problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=interfaces, solver="auto")
    return problem, problem.solve(), V


def test_bodies_are_asked_together(monkeypatch):
    """The number of back-substitutions for motions on springs does not grow with the bodies; each
    joint carries the weight above it, less what the springs take."""
    count, solve = [0], DirectSolver.solve

    def counted(self, *given, **named):
        count[0] += 1
        return solve(self, *given, **named)

    monkeypatch.setattr(DirectSolver, "solve", counted)
    asked = []
    for n in (4, 12):
        count[0] = 0
        problem, u, V = stack(n)
        asked.append(count[0])
        assert len(problem.interfaces) == n - 1
        x = V.tabulate_dof_coordinates()
        cells = compat.cell_dofs(V)
        up = u.x.array.reshape(-1, 2)[:, 1]
        mean = up[cells].mean(axis=1)  # bilinear, on rectangles
        area = np.prod(np.ptp(x[cells], axis=1)[:, :2], axis=1)
        height = x[cells].mean(axis=1)[:, 1]
        for joint, result in enumerate(problem.results, start=1):
            above = height > joint
            carried = (area[above] * (1e-3 + 1e-2 * mean[above])).sum()
            assert abs(abs(result.resultant[1]) / carried - 1.0) <= 1e-8
    assert asked[1] <= asked[0] + 3
