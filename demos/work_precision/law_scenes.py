"""Opening and friction with known answers, for ``error_vs_time.py``; needs gmsh."""

import cattaneo_mindlin
import hertz3d
import numpy as np
import ufl
from convergence import LOWER, UPPER, blocks
from dolfinx import fem, mesh
from hertz2d import hold
from work_precision.scenes import Scene

import dolfinx_llm as llm
from dolfinx_llm import compat


class Hertz3D(Scene):
    """A spherical end on a rigid plane, n elements over the radius; the others grow by 1 / n."""

    def problem(self, comm, n, method, **options):
        return hertz3d.problem("plane", (n, n), growth=1.0 + 1.0 / n, comm=comm, **options)

    def errors(self, u, problem=None):
        """Of nodal forces over areas inside 0.8 a, rms over the peak."""
        if problem is None:
            return {}
        a, (_, _, peak) = hertz3d.SCENES["plane"][3], hertz3d.hertz("plane")
        side = problem.results[0].sides[0]
        r = np.hypot(*side.x[:, :2].T) / a
        inner = r < 0.8
        found = side.normal_force[inner] / side.area[inner] / peak
        weight = side.area[inner] / side.area[inner].sum()
        return {"pressure": np.sqrt(weight @ (found - np.sqrt(1.0 - r[inner] ** 2)) ** 2)}

    def matching(self, comm, n):
        """The same body, held where it may touch."""
        R, E, nu, a = hertz3d.SCENES["plane"]
        domain, tags = hertz3d.block(comm, a, n, 1, R, growth=1.0 + 1.0 / n)
        V = compat.function_space(domain, shape=(3,))
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        load = w[2] * ufl.ds(domain=domain, subdomain_data=tags)(hertz3d.FAR)
        bcs = [hold(V, k, lambda x, k=k: np.isclose(x[k], 0.0)) for k in (0, 1)]
        held = fem.locate_dofs_topological(V.sub(2), 2, tags.find(hertz3d.CONTACT))
        bcs.append(fem.dirichletbc(fem.Constant(domain, 0.0), held, V.sub(2)))
        return V, ufl.inner(hertz3d.stress(u, E, nu), ufl.grad(w)) * ufl.dx, -load, bcs


class CattaneoMindlin(Scene):
    """Two cylinders pressed, then loaded along the surface in four steps; n and about 1.46 n
    elements over the half-width."""

    def problem(self, comm, n, method, **options):
        self.elements = n, round(1.46 * n)
        self.discs = cattaneo_mindlin.Discs(self.elements, 0.1, comm=comm, **options)
        return self.discs.problem

    def solve(self, problem):
        self.discs.run(4)
        return problem.u

    def errors(self, u, problem):
        found = cattaneo_mindlin.figures(problem, self.elements, 0.1)
        return {"traction": found["L2 error of q"]}


class Dragged(Scene):
    """A cube pressed onto another and dragged by its top in four steps, from stick to full slip,
    where the sum of the frictional forces is μ N."""

    mu, drags = 0.3, (0.0, 0.002, 0.01, 0.06)

    def problem(self, comm, n, method, **options):
        domain, tags = blocks(comm, n, round(1.3 * n))
        V = compat.function_space(domain, shape=(3,))
        a, L, bcs, (self.along, down) = self.forms(V)
        down.x.array[:] = -0.004
        interface = llm.Interface(tags, (LOWER, UPPER), law=llm.Coulomb(self.mu))
        return llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface], **options)

    def forms(self, V):
        """a, L, Dirichlet conditions, and motions of the top along x and z."""
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        bcs = [hold(V, k, lambda x: np.isclose(x[2], 0.0)) for k in range(3)]
        bcs += [hold(V, k, lambda x: np.isclose(x[2], 2.0)) for k in range(3)]
        a = ufl.inner(hertz3d.stress(u, 1.0, 0.3), ufl.grad(w)) * ufl.dx
        return a, -fem.Constant(V.mesh, 1e-4) * w[2] * ufl.dx, bcs, (bcs[3].g, bcs[5].g)

    def solve(self, problem):
        for drag in self.drags:
            self.along.x.array[:] = drag
            problem.solve()
        return problem.u

    def errors(self, u, problem=None):
        if problem is None:
            return {}
        result = problem.results[0]
        friction = np.linalg.norm(result.frame_friction, axis=1).sum()
        return {"friction": abs(friction / (self.mu * abs(result.resultant[2])) - 1.0)}

    def matching(self, comm, n):
        nodes = (n + 1) ** 3 + (round(1.3 * n) + 1) ** 3
        m = round((nodes / 2) ** (1 / 3)) - 1
        corners = [np.zeros(3), np.array([1.0, 1.0, 2.0])]
        domain = mesh.create_box(comm, corners, [m, m, 2 * m], mesh.CellType.hexahedron)
        V = compat.function_space(domain, shape=(3,))
        return V, *self.forms(V)[:3]


SCENES = {
    "Hertz 3D": Hertz3D(), "Cattaneo-Mindlin": CattaneoMindlin(), "dragged block": Dragged(),
}  # fmt: skip
