"""Bodies that contact alone holds, at finite deformation: load is taken off, and put on again."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from finite_patch import lame, residual
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

P = 10.0


def drawn(low, high, n):
    """A block with tags 1 below and 2 above."""
    dim = len(low)
    if dim == 2:
        kind, make = mesh.CellType.triangle, mesh.create_rectangle
    else:
        kind, make = mesh.CellType.tetrahedron, mesh.create_box
    domain = make(MPI.COMM_WORLD, [low, high], n, kind)
    found = [
        mesh.locate_entities_boundary(domain, dim - 1, lambda p, z=z: np.isclose(p[dim - 1], z))
        for z in (low[-1], high[-1])
    ]
    values = np.repeat(np.array([1, 2], dtype=np.int32), [len(f) for f in found])
    order = np.argsort(np.concatenate(found))
    return domain, mesh.meshtags(domain, dim - 1, np.concatenate(found)[order], values[order])


@pytest.mark.parametrize(
    ("dim", "floor"), [(2, "body"), (2, "plane"), longer(3, "body"), longer(3, "plane")]
)
def test_a_block_stays_where_its_load_vanishes(dim, floor):
    """It was put 2 to 14 of its widths away, without a word, and the next step failed."""
    side = [0.0] * (dim - 1)
    block = drawn([*[-0.5] * (dim - 1), 0.0], [*[0.5] * (dim - 1), 0.6], [6] * (dim - 1) + [4])
    bodies = [block]
    if floor == "body":
        low, high = [*[-1.0] * (dim - 1), -1.0], [*[1.0] * (dim - 1), 0.0]
        bodies.append(drawn(low, high, [9] * (dim - 1) + [5]))
        side = (block[1], 1), (bodies[1][1], 2)
    else:
        plane = llm.RigidPlane(np.zeros(dim), np.eye(dim)[-1])
        side = (block[1], 1), plane
    spaces = [compat.function_space(domain, shape=(dim,)) for domain, _ in bodies]
    u = [fem.Function(V) for V in spaces]
    forms = [residual(one, *lame(1e4, 0.3)) for one in u]
    load = fem.Constant(block[0], np.zeros(dim))
    ds = ufl.Measure("ds", domain=block[0], subdomain_data=block[1])
    forms[0] -= ufl.inner(load, ufl.TestFunction(spaces[0])) * ds(2)
    bcs = []
    if floor == "body":
        held = fem.locate_dofs_geometrical(spaces[1], lambda p: np.isclose(p[dim - 1], -1.0))
        bcs = [fem.dirichletbc(np.zeros(dim), held, spaces[1])]
    interface = llm.Interface(None, side, law=llm.Coulomb(0.3))
    problem = llm.NonlinearContactProblem(forms, u, bcs=bcs, interfaces=[interface])
    pressed, free = [], []
    for down in 4 * (P, 0.0):
        load.value[-1] = -down
        problem.solve()
        (result,) = problem.results
        (pressed if down else free).append(u[0].x.array.copy())
        assert np.abs(result.resultant + down * np.eye(dim)[-1]).max() <= 1e-9 * P
        assert min(side.gap.min() for side in result.sides) >= -1e-12
        assert len(problem.history) <= 12
    # Without load it is where it was drawn, but for what friction has kept, which goes then.
    deflection = np.abs(pressed[0]).max()
    assert all(np.abs(one).max() <= 0.005 * deflection for one in free)
    assert all(np.abs(one - pressed[0]).max() <= 0.005 * deflection for one in pressed)
