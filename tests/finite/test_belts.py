"""A thin belt pulled over a drum by a quarter of a turn: Euler and Eytelwein, exp(mu pi / 2).

Thin belts press softly on what is round: an iteration moves nodes along tangents, and off the drum
by more than the pressure over the stiffness.
"""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from finite_patch import residual
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

THICK, LEG, E, MU, LOAD = 0.02, 0.8, 1000.0, 0.2, 0.2  # over the drum's radius; force per width
INSIDE, LOOSE, PULLED = 1, 2, 3


def bent(s):
    """(n, 2) points at a way along the belt, which goes up, round the drum and to the right, and at
    a depth in it."""
    way, r = s[:, 0], 1.0 + s[:, 1]
    turn = np.clip(way, 0.0, 0.5 * np.pi)
    up, on = np.minimum(way, 0.0), np.maximum(way - 0.5 * np.pi, 0.0)
    return np.column_stack([on - r * np.cos(turn), up + r * np.sin(turn)])


class Belt:
    """The belt on a rigid drum, loaded at one end; ``pull`` goes on from
    there.

    Args:
        order: of the elements.
        cells: of the belt, along a quarter of a turn.
        angle: of the whole scene [rad].
    """

    def __init__(self, order, cells=24, angle=0.0):
        c, s = np.cos(angle), np.sin(angle)
        self.Q = np.array([[c, -s], [s, c]])
        ends, n = ((-LEG, 0.0), (0.5 * np.pi + LEG, THICK)), 2 * cells
        domain = mesh.create_rectangle(MPI.COMM_SELF, ends, (n, 2), mesh.CellType.quadrilateral)
        facets = [mesh.locate_entities_boundary(domain, 1, where) for where in (
            lambda x: np.isclose(x[1], 0.0),
            lambda x: np.isclose(x[0], ends[0][0]),
            lambda x: np.isclose(x[0], ends[1][0]),
        )]  # fmt: skip
        x = domain.geometry.x
        x[:, :2] = bent(x[:, :2]) @ self.Q.T
        values = np.repeat([INSIDE, LOOSE, PULLED], [len(f) for f in facets]).astype(np.int32)
        at = np.argsort(np.concatenate(facets))
        tags = mesh.meshtags(domain, 1, np.concatenate(facets)[at], values[at])
        self.V = V = compat.function_space(domain, degree=order, shape=(2,))
        self.u, self.end = fem.Function(V), fem.Function(V)
        ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
        self.load = fem.Constant(domain, (0.0, 0.0))
        F = residual(self.u, E / 2.6, E * 0.3 / 1.3 / 0.4, order)
        F -= ufl.inner(self.load, ufl.TestFunction(V)) * ds(LOOSE)
        held = fem.locate_dofs_topological(V, 1, tags.indices[tags.values == PULLED])
        disc = llm.RigidSphere((0.0, 0.0), 1.0)
        self.problem = llm.NonlinearContactProblem(
            F, self.u, bcs=[fem.dirichletbc(self.end, held)],
            interfaces=[llm.Interface(tags, (INSIDE, disc), law=llm.Coulomb(MU))],
        )  # fmt: skip
        for part in (0.5, 1.0):
            self.load.value = self.Q @ (0.0, -part * LOAD / THICK)
            self.problem.solve()

    def pull(self, way):
        """The force at the end over the load, which Euler and Eytelwein tell."""
        self.end.interpolate(lambda x: np.outer(self.Q @ (way, 0.0), np.ones(x.shape[1])))
        self.problem.solve()
        borne = self.Q.T @ self.problem.results[0].resultant
        return abs(borne[0]) / LOAD


@pytest.mark.parametrize(("order", "angle"), [(1, 0.0), (1, 0.7), (2, 0.0)])
def test_a_belt_pulled_over_a_drum(order, angle):
    belt = Belt(order, angle=angle)
    for step in range(1, 6):
        force = belt.pull(0.03 * step)
        iterations = len(belt.problem.history)
        assert iterations <= 12, iterations
        assert {entry["part"] for entry in belt.problem.history} == {1.0}
    np.testing.assert_allclose(force, np.exp(0.5 * np.pi * MU), rtol=0.02)
