"""A punch on a wider foundation at finite deformation: bottom held, the punch's top moved."""

import finite_patch
import numpy as np
import patch2d
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat


class Punch:
    """Two rough bodies on meshes that do not match, the foundation's is the coarser one.

    Args:
        kind: cells, "quad", "tri", "hex" or "tet".
        law: of the interface.
        lift: how far the punch is moved up at first; nothing touches then.
        energy: of a displacement and the Lamé constants mu and lambda.
        closed: whether the bodies' whole outlines can touch.
        degree: of the elements.
        solver: of Newton's systems.

    Attributes:
        bcs: the problem's own list, of the foundation and the punch.
    """

    def __init__(
        self,
        kind="quad",
        law=None,
        lift=0.0,
        energy=finite_patch.energy,
        comm=MPI.COMM_SELF,
        closed=False,
        degree=1,
        solver="auto",
    ):
        self.dim = dim = 2 if kind in ("quad", "tri") else 3
        low = (0.0,) * dim, (1.6, *(1.0,) * (dim - 1)), (6, 3) if dim == 2 else (4, 3, 2)
        corner, size = (0.4, 0.2)[: dim - 1], (0.8, 0.6)[: dim - 1]
        high = (*corner, 1.0), (*size, 0.5), (4, 2) if dim == 2 else (3, 3, 1)
        scene = patch2d.bodies(comm, kind, separate=True, boxes=(low, high), rough=0.2)
        self.u, forms, self.bcs, self.ends = [], [], [], []
        for k, (domain, _) in enumerate(scene):
            V = compat.function_space(domain, degree=degree, shape=(dim,))
            u = fem.Function(V)
            lame = (fem.Constant(domain, c) for c in finite_patch.lame(1000.0, 0.3))
            dx = ufl.dx(degree=3 if degree == 1 else 4)
            forms.append(ufl.derivative(energy(u, *lame) * dx, u, ufl.TestFunction(V)))
            held = fem.locate_dofs_geometrical(V, lambda p, z=1.5 * k: np.isclose(p[dim - 1], z))
            self.ends.append(fem.Constant(domain, np.zeros(dim)))
            self.bcs.append(fem.dirichletbc(self.ends[-1], held, V))
            self.u.append(u)
        self.u[1].x.array[dim - 1 :: dim] = lift
        sides = (scene[0][1], patch2d.FOUNDATION_TOP), (scene[1][1], patch2d.PUNCH_BOTTOM)
        if closed:
            sides = tuple((outline(domain), 1) for domain, _ in scene)
        interface = llm.Interface(None, sides, law=law or llm.Frictionless())
        self.problem = llm.NonlinearContactProblem(
            forms, self.u, bcs=self.bcs, interfaces=[interface], solver=solver
        )

    def to(self, down, along=0.0, increments=1):
        """Move the punch's top; the result."""
        self.ends[1].value[-1], self.ends[1].value[0] = -down, along
        self.problem.solve(increments)
        return self.problem.results[0]


def outline(domain):
    """Tag 1 on all of a mesh's boundary."""
    d = domain.topology.dim
    domain.topology.create_connectivity(d - 1, d)
    facets = mesh.exterior_facet_indices(domain.topology)
    return mesh.meshtags(domain, d - 1, facets, np.ones(len(facets), dtype=np.int32))


def small_strains(u, mu, lam):
    """Linear elasticity: finite where cells are turned inside out."""
    strain = ufl.sym(ufl.grad(u))
    return lam / 2 * ufl.tr(strain) ** 2 + mu * ufl.inner(strain, strain)
