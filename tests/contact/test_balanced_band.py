"""A band on a rigid drum, both ends of which are pulled alike, with friction."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

THIN, FROM, TO = 0.02, np.deg2rad(15.0), np.deg2rad(165.0)


@pytest.mark.parametrize(
    ("mu", "cells", "angle"), [(0.1, 39, 0.0), (0.1, 45, 0.7), (0.5, 33, 0.7), (0.3, 52, 0.0)]
)
def test_it_stays(mu, cells, angle):
    """All but some nodes slip; with all of them slipping 1e-8 of the forces is left, which was
    taken for a band that is pulled off. The condensed form tells it."""
    domain = mesh.create_rectangle(
        MPI.COMM_SELF, [[FROM, 0.0], [TO, THIN]], [cells, 1], mesh.CellType.triangle
    )
    found = [
        mesh.locate_entities_boundary(domain, 1, lambda p, k=k, x=x: np.isclose(p[k], x))
        for k, x in ((1, 0.0), (0, FROM), (0, TO))
    ]
    values = np.repeat(np.array([1, 2, 3], dtype=np.int32), [len(f) for f in found])
    order = np.argsort(np.concatenate(found))
    tags = mesh.meshtags(domain, 1, np.concatenate(found)[order], values[order])
    x = domain.geometry.x
    turn, r = x[:, 0] + angle, 1.0 + x[:, 1]
    x[:, 0], x[:, 1] = r * np.cos(turn), r * np.sin(turn)
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
    a = 1e5 * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx
    ends = [
        fem.Constant(domain, s * np.array([-np.sin(t + angle), np.cos(t + angle)]) / THIN)
        for s, t in ((-1.0, FROM), (1.0, TO))
    ]
    L = ufl.inner(ends[0], w) * ds(2) + ufl.inner(ends[1], w) * ds(3)
    drum = llm.RigidSphere((0.0, 0.0), 1.0)
    interface = llm.Interface(tags, (1, drum), law=llm.Coulomb(mu))
    problem = llm.ContactProblem(a, L, interfaces=[interface])
    problem.solve()
    (side,) = problem.results[0].sides
    moment = side.x[:, 0] * side.force[:, 1] - side.x[:, 1] * side.force[:, 0]
    assert abs(moment.sum()) <= 1e-9
    # What presses is between the tension of the ends and that of the middle, over the angle.
    least = np.exp(-mu * 0.5 * (TO - FROM))
    assert least < side.normal_force.sum() / (TO - FROM) < 1.0
    assert np.abs(problem.u.x.array).max() <= 1e-2
