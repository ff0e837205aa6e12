"""A band round a disc, both ends pulled alike, from rest in one step: friction alone holds it."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from facing_scenes import tagged
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

E, THICK = 1e5, 0.02
FROM, OVER = np.deg2rad([15.0, 150.0])


@pytest.mark.parametrize(
    ("mu", "cells", "force"),
    [(0.3, 52, 1.0), (0.2, 52, 1.0), longer(0.3, 130, 1.0), longer(0.3, 52, 10.0)],
)
def test_stays_where_it_is(mu, cells, force):
    """It slips towards both ends alike, and bears what a band does that slips from its middle on;
    it went round the disc by 0.2 to 0.3 rad, all of it slipping one way."""
    domain = mesh.create_rectangle(
        MPI.COMM_SELF, [[0.0, 0.0], [1.0, THICK]], [cells, 1], mesh.CellType.quadrilateral
    )
    sides = [
        mesh.locate_entities_boundary(domain, 1, lambda p, k=k, at=at: np.isclose(p[k], at))
        for k, at in ((1, 0.0), (0, 0.0), (0, 1.0))
    ]
    tags = tagged(domain, sides)
    x = domain.geometry.x
    turned = FROM + OVER * x[:, 0]
    x[:, :2] = (1.0 + x[:, 1:2]) * np.stack([np.cos(turned), np.sin(turned)], axis=1)
    V = compat.function_space(domain, shape=(2,))
    u, w, ds = fem.Function(V), ufl.TestFunction(V), ufl.Measure("ds", domain, subdomain_data=tags)
    F = E * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx
    for tag, at, way in ((2, FROM, 1.0), (3, FROM + OVER, -1.0)):
        along = way * np.array([np.sin(at), -np.cos(at)])
        F -= ufl.dot(fem.Constant(domain, force / THICK * along), w) * ds(tag)
    disc = llm.RigidSphere((0.0, 0.0), 1.0)
    interface = llm.Interface(tags, (1, disc), law=llm.Coulomb(mu))
    problem = llm.NonlinearContactProblem(F, u, interfaces=[interface])
    problem.solve()
    slips_from_the_middle = 2.0 * force * (1.0 - np.exp(-mu * OVER / 2.0)) / mu
    assert problem.results[0].frame_force.sum() == pytest.approx(slips_from_the_middle, rel=5e-3)
    stretch = force / (E * THICK) * OVER / 2.0
    assert np.abs(u.x.array).max() <= 1.1 * stretch
