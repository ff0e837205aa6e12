"""Bodies that fly: what acts at the centre of mass does not turn them, damped or not."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from finite_patch import lame, residual
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat


@pytest.mark.parametrize("damping", [0.0, 0.1])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_projectile_does_not_spin(dim, damping):
    """Along a parabola with 10 m/s; damped steps had turned it by 0.6 rad/s in 0.1 s."""
    n, dt, g, side = 6, 2e-3, 10.0, 0.1
    if dim == 2:
        domain = mesh.create_rectangle(MPI.COMM_SELF, [[0.0] * 2, [side] * 2], [n] * 2,
                                       mesh.CellType.quadrilateral)  # fmt: skip
    else:
        domain = mesh.create_box(MPI.COMM_SELF, [[0.0] * 3, [side] * 3], [n] * 3,
                                 mesh.CellType.hexahedron)  # fmt: skip
    V = compat.function_space(domain, shape=(dim,))
    u, w, down = fem.Function(V), ufl.TestFunction(V), np.eye(dim)[-1]
    weight = fem.Constant(domain, -g * down)
    F = residual(u, *lame(1e6, 0.3)) - ufl.inner(1e3 * weight, w) * ufl.dx
    facets = mesh.locate_entities_boundary(domain, dim - 1, lambda p: np.isclose(p[dim - 1], 0.0))
    tags = mesh.meshtags(domain, dim - 1, np.sort(facets), np.ones(len(facets), dtype=np.int32))
    plane = llm.RigidPlane(-100.0 * down, down)
    interface = llm.Interface(tags, (1, plane), law=llm.Frictionless())
    s = llm.TimeStepper(1e3, F, u, dt=dt, damping=damping, interfaces=interface)
    s.v.x.array.reshape(-1, dim)[:] = 10.0 * np.eye(dim)[0]
    for _ in range(20):
        s.step()
    moved = u.x.array.reshape(-1, dim)
    assert np.abs(moved - moved.mean(axis=0)).max() <= 1e-4 * side  # no turn
    fall = 0.5 * g * s.t**2 * (1.0 + damping * dt / s.t)  # of the rule
    np.testing.assert_allclose(
        moved.mean(axis=0)[[0, -1]], [10.0 * s.t, -fall], rtol=0.0, atol=1e-5
    )
