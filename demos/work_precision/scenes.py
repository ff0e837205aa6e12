"""The scenes of ``error_vs_time.py``: bodies, forms, contact problems and their errors."""

import numpy as np
import paper_data
import patch3d
import ufl
from convergence import LOWER, UPPER, blocks, field_errors, pressure_error
from convergence import body_forms as cube_forms
from dolfinx import fem, mesh
from work_precision.plan import MATCHING, POSITIONS, UNDESIGNED, WEIGHTS

import dolfinx_llm as llm
from dolfinx_llm import compat


class Scene:
    """What scenes do unless they say otherwise."""

    def solve(self, problem):
        """The displacement, of one load step."""
        return problem.solve()


class Patch(Scene):
    """The paper's 3D patch test, every cell split n times a direction."""

    sides = paper_data.FOUNDATION_TOP, paper_data.PUNCH_BOTTOM

    def bodies(self, comm, n):
        domain, tags = paper_data.scene(comm, n)
        return compat.function_space(domain, shape=(3,)), tags

    def forms(self, V, tags):
        """a, L, Dirichlet conditions, nodal loads."""
        return *patch3d.body_forms(V), patch3d.supports(V), patch3d.loads(V, tags)

    def problem(self, V, tags, method, **options):
        # Positions: Table 2's frame, moved to pass with these meshes.
        kind = {POSITIONS: "optimised", WEIGHTS: "automatic"}
        return patch3d.problem(V, tags, kind.get(method, "undesigned"), **options)

    def errors(self, u, problem=None, pressure=None):
        return {"von_mises": patch3d.stress_error(u)}

    def matching(self, comm, n):
        """The foundation with a square punch of its own quads: one mesh of about the same size."""
        (x, quads), _ = paper_data.cross_sections(n)
        z = np.linspace(0.0, 2.0, 6 * n + 1)
        points, cells = paper_data.extrude(x, quads, z)
        middle = points[cells].mean(axis=1)
        cells = cells[(middle[:, 2] < 1.0) | (np.abs(middle[:, :2]).max(axis=1) < 1.05)]
        used, cells = np.unique(cells, return_inverse=True)
        points, cells = points[used], cells.reshape(-1, 8)
        if comm.rank:
            points, cells = points[:0], cells[:0]
        domain = compat.create_mesh(comm, cells, points, "hexahedron")
        V = compat.function_space(domain, shape=(3,))
        w, up = ufl.TestFunction(V), ufl.FacetNormal(domain)[2]
        top = ufl.conditional(ufl.gt(ufl.SpatialCoordinate(domain)[2], 0.5), 1.0, 0.0)
        level = ufl.conditional(ufl.gt(up, 0.5), top, 0.0)
        a, _ = patch3d.body_forms(V)
        return V, a, -paper_data.PRESSURE * level * w[2] * ufl.ds, patch3d.supports(V)

    def slip_supports(self, V):
        """What holds a punch that may slide, at its exact place: the nodes on top with y = 0."""
        exact = [fem.Function(V.sub(k).collapse()[0]) for k in (0, 1)]
        rate = paper_data.NU * paper_data.PRESSURE / paper_data.E
        bcs = []
        for k, g in enumerate(exact):
            g.interpolate(lambda x, k=k: rate * x[k])
            dofs = fem.locate_dofs_geometrical(
                (V.sub(k), g.function_space), lambda x: np.isclose(x[2], 2.0) & np.isclose(x[1], 0)
            )
            bcs.append(fem.dirichletbc(g, dofs, V.sub(k)))
        return bcs


class Cubes(Scene):
    """Two cubes with n and 1.5 n bricks a side, a manufactured field."""

    sides = LOWER, UPPER

    def bodies(self, comm, n):
        domain, tags = blocks(comm, n, 3 * n // 2)
        return compat.function_space(domain, shape=(3,)), tags

    def forms(self, V, tags):
        return *cube_forms(V), []

    def problem(self, V, tags, method, **options):
        design = {POSITIONS: "positions", WEIGHTS: "weights"}.get(method)
        a, L, bcs, _ = self.forms(V, tags)
        interface = llm.Interface(tags, self.sides, design=design)
        return llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface], **options)

    def errors(self, u, problem=None, pressure=None):
        if problem is not None and problem.results:
            result = problem.results[0]
            pressure = result.frame.x, result.frame_area, result.pressure
        found = {} if pressure is None else {"pressure": pressure_error(*pressure)}
        return {**field_errors(u), **found}

    def matching(self, comm, n):
        corners = [np.zeros(3), np.array([1.0, 1.0, 2.0])]
        domain = mesh.create_box(comm, corners, [n, n, 2 * n], mesh.CellType.hexahedron)
        V = compat.function_space(domain, shape=(3,))
        return V, *cube_forms(V)


class Hertz(Scene):
    """Two cylinders, n and about 1.5 n elements over the half-width of contact."""

    def problem(self, comm, n, method, **options):
        import hertz2d  # needs gmsh

        design = {POSITIONS: "positions", WEIGHTS: "weights", UNDESIGNED: None}.get(method, "auto")
        elements = (n, n) if method == MATCHING else (n, round(1.46 * n))
        return hertz2d.problem("cylinders", elements, comm=comm, design=design, **options)

    def errors(self, u, problem):
        """Of the pressure on the frame, against averages of Hertz's over its nodes' hats."""
        import hertz2d

        frame = hertz2d.figures(problem, *hertz2d.hertz("cylinders"))["frame"]
        return {"pressure": frame["L2 error"], "peak": abs(frame["peak"] - 1.0)}


SCENES = {"patch test": Patch(), "manufactured": Cubes(), "Hertz": Hertz()}
