"""A flat tool, all of which supports move, on a block with larger facets; boxes."""

import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

E, NU = 100.0, 0.3
KINDS = {
    "quadrilateral": mesh.CellType.quadrilateral,
    "triangle": mesh.CellType.triangle,
    "hexahedron": mesh.CellType.hexahedron,
    "tetrahedron": mesh.CellType.tetrahedron,
}


class FlatTool:
    """A block [-1, 1] x ... x [-1, 0] with ``cells`` across and half of them high, held below, and
    a tool above it.

    Args:
        kind: of all cells.
        cells: of the block, across.
        across: of the tool.
        half: its half width.
        order: of the elements.
        finite: whether at finite deformation.
        rigid: a plane in its place.
        options: of the problem.
    """

    def __init__(self, kind, cells, across, half, order, law, finite=True, rigid=False, **options):
        gdim = 3 if kind in ("hexahedron", "tetrahedron") else 2
        self.gdim, self.bcs, self.u, forms = gdim, [], [], []
        sizes = ((cells, cells // 2, -1.0, 1.0, -1.0, 0.0), (across, 1, -half, half, 0.0, 0.5))
        sides = []
        for k, (n, layers, left, right, low, high) in enumerate(sizes[: 1 if rigid else 2]):
            ends = [[left] * (gdim - 1) + [low], [right] * (gdim - 1) + [high]]
            make = mesh.create_box if gdim == 3 else mesh.create_rectangle
            domain = make(MPI.COMM_SELF, ends, [n] * (gdim - 1) + [layers], KINDS[kind])
            facets = mesh.locate_entities_boundary(
                domain, gdim - 1, lambda x: np.isclose(x[gdim - 1], 0.0)
            )
            one = np.full(len(facets), 1, dtype=np.int32)
            sides.append((mesh.meshtags(domain, gdim - 1, np.sort(facets), one), 1))
            V = compat.function_space(domain, degree=order, shape=(gdim,))
            bottom = (lambda x: np.isclose(x[gdim - 1], -1.0)) if k == 0 else (lambda x: x[0] < 9.0)
            self.moved = fem.Function(V)
            self.bcs.append(fem.dirichletbc(self.moved, fem.locate_dofs_geometrical(V, bottom)))
            forms.append(self._form(V, finite))
        self.plane = llm.RigidPlane((0.0,) * gdim, (0.0,) * (gdim - 1) + (-1.0,)) if rigid else None
        if rigid:
            sides.append(self.plane)
        interface = llm.Interface(None, tuple(sides), law=law)
        chosen = {"bcs": self.bcs, "interfaces": [interface], **options}
        if finite:
            self.problem = llm.NonlinearContactProblem(forms, self.u, **chosen)
        else:
            a, L = map(list, zip(*forms, strict=True))
            self.problem = llm.ContactProblem(a, L, **chosen)

    def _form(self, V, finite):
        w, mu, lam = ufl.TestFunction(V), E / 2 / (1 + NU), E * NU / (1 + NU) / (1 - 2 * NU)
        if not finite:
            e = ufl.sym(ufl.grad(ufl.TrialFunction(V)))
            stress = 2 * mu * e + lam * ufl.tr(e) * ufl.Identity(self.gdim)
            zero = fem.Function(V)
            return ufl.inner(stress, ufl.grad(w)) * ufl.dx, ufl.inner(zero, w) * ufl.dx
        u = fem.Function(V)
        self.u.append(u)
        F = ufl.Identity(self.gdim) + ufl.grad(u)
        J = ufl.det(F)
        energy = mu / 2 * (ufl.tr(F.T * F) - self.gdim) - mu * ufl.ln(J) + lam / 2 * ufl.ln(J) ** 2
        return ufl.derivative(energy * ufl.dx(degree=4), u, w)

    def press(self, *motion, tilt=0.0):
        """The result after a motion (gdim,) of the tool, that is higher by tilt times x as well."""
        if self.plane is None:
            x = self.moved.function_space.tabulate_dof_coordinates()
            moved = np.tile(motion, (len(x), 1))
            moved[:, -1] += tilt * x[:, 0]
            self.moved.x.array[:] = moved.ravel()
        else:
            self.plane.displacement = motion
        self.problem.solve()
        return self.problem.results[0]
