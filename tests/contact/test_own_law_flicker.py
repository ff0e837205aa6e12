"""A law of one's own along the surface, whose pairs at the rim of contact pull themselves open by
their ties and press without them."""

import numpy as np
import pairs
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat


class Viscous(llm.Law):
    """Resists sliding in proportion to it, however little presses."""

    slips = True

    def force(self, nodes):
        k = 300.0 * nodes.area[:, None]
        return k * nodes.slip, np.repeat(k, nodes.slip.shape[1], axis=1)


def tagged(domain, faces):
    """Tags 1, 2, ... of the boundary where coordinates have values."""
    found = [
        mesh.locate_entities_boundary(domain, 2, lambda p, i=i, at=at: np.isclose(p[i], at))
        for i, at in faces
    ]
    values = np.repeat(np.arange(1, len(found) + 1), [len(f) for f in found]).astype(np.int32)
    facets = np.concatenate(found)
    order = np.argsort(facets)
    return mesh.meshtags(domain, 2, facets[order], values[order])


def test_comes_to_rest():
    """Two blocks that rest on a third one are pressed and rubbed against each other: one pair in
    72 changed for ever, with a residual of 2e-14."""
    bodies = [
        ((5, 3, 2), (0.0, 0.0, 0.0), (2.0, 1.0, 0.5), "hexahedron", 900.0, (0, 0, 0)),
        ((3, 2, 2), (0.1, 0.1, 0.5), (1.0, 0.9, 1.2), "tetrahedron", 600.0, (3, 4, -10)),
        ((2, 3, 3), (1.0, 0.05, 0.5), (1.9, 0.95, 1.3), "hexahedron", 1500.0, (-2, -4, -8)),
    ]
    forms, loads, bcs, tags = [], [], [], []
    for i, (n, low, high, kind, E, moved) in enumerate(bodies):
        domain = pairs.block(MPI.COMM_SELF, n, low, high, kind)[0]
        V = compat.function_space(domain, shape=(3,))
        u, w, known = ufl.TrialFunction(V), ufl.TestFunction(V), fem.Function(V)
        forms.append(E / pairs.E * ufl.inner(pairs.stress(u), ufl.grad(w)) * ufl.dx)
        loads.append(ufl.inner(fem.Constant(domain, np.zeros(3)), w) * ufl.dx)
        known.x.array[:] = np.tile(1e-3 * np.array(moved), len(known.x.array) // 3)
        end = low[2] if i == 0 else high[2]
        dofs = fem.locate_dofs_geometrical(V, lambda p, end=end: np.isclose(p[2], end))
        bcs.append(fem.dirichletbc(known, dofs))
        tags.append(tagged(domain, [(2, 0.5), (0, 1.0)] if i else [(2, 0.5)]))
    smooth = llm.Frictionless()
    interfaces = [
        llm.Interface(None, ((tags[0], 1), (tags[1], 1)), law=smooth),
        llm.Interface(None, ((tags[0], 1), (tags[2], 1)), law=smooth),
        llm.Interface(None, ((tags[1], 2), (tags[2], 2)), law=Viscous()),
    ]
    with llm.ContactProblem(forms, loads, bcs=bcs, interfaces=interfaces) as problem:
        problem.solve()
        rubbed = problem.results[2]
        assert len(problem.history) <= 15 and problem.history[-1]["residual"] <= 1e-12
        assert min(side.normal_force.min() for side in rubbed.sides) >= 0.0
        loose = [s.status == 3 for s in rubbed.sides]
        lost = sum(s.normal_force[at].sum() for s, at in zip(rubbed.sides, loose, strict=True))
        assert sum(map(sum, loose)) == 1 and 0.0 < lost <= 1e-2 * rubbed.frame_force.sum()
        assert np.abs(rubbed.resultant[1:]).max() > 5e-3 * abs(rubbed.resultant[0])
