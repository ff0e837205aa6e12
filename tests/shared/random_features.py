"""Random scenes of what users combine, and what happens between their load steps: rigid ends,
means, guides, thicknesses, laws with values from anywhere; states saved, carried over, let go.

Stacks of two or three blocks in gmsh's meshes, on soft springs. What is held against what: the
balance of each body that no condition holds, from forces of sides, loads and springs alone.
"""

import dataclasses

import around_axis
import finite_patch
import gmsh
import numpy as np
import ufl
from dolfinx import fem

import dolfinx_llm as llm
from dolfinx_llm import compat

NU, SPRING, STRAIN = 0.3, 1e-2, 1e-2  # springs over the least modulus; pressed together by
PATH = ((1.0, 0.0), (1.0, 1.0), (0.4, 1.0), (0.7, -0.5))  # of load steps: down, and along
LAWS = ("tied", "close", "frictionless", "mu", "of x", "of cells", "Constant", "cohesion")
LINEAR = ("gap", "sliding", "dynamic")  # at small deformation alone
FIRST_ORDER = ("gap", "sliding")  # of these with bodies of first order alone
BELOW = ("clamped", "plane", "end", "mean")
ABOVE = ("moved", "end", "mean", "pressed", "plane")
BETWEEN = ("nothing", "saved", "transfer", "modulus", "held", "reset", "mu")


@dataclasses.dataclass
class Scene:
    """What is drawn."""

    seed: int
    gdim: int
    nonlinear: bool
    order: int
    quads: bool
    widths: list
    heights: list
    sizes: list  # of cells
    E: list
    laws: list  # (kind, mu) from block to block
    below: str
    above: str
    thickness: str
    guided: bool
    swapped: bool
    between: str  # the second step and the third

    @property
    def gaps(self):
        return [0.003 * (kind == "close") for kind, _ in self.laws] + [0.0]

    @property
    def twofold(self):
        """Whether two interfaces hold the same motion of nodes, so that forces are not unique."""
        return self.guided and self.below == "end"


def draw(seed):
    """Scene of a seed."""
    rng = np.random.default_rng([seed, 98])
    gdim, blocks = (int(rng.choice(of)) for of in ((2, 2, 3), (2, 3)))
    nonlinear = bool(rng.random() < 0.45)
    between = str(rng.choice(BETWEEN))
    second = gdim == 2 and rng.random() < 0.33 and (nonlinear or between != "transfer")
    every = LAWS if nonlinear else LAWS + LINEAR
    kinds = [kind for kind in every if not (second and kind in FIRST_ORDER)]
    return Scene(
        seed,
        gdim,
        nonlinear,
        2 if second else 1,
        gdim == 2 and bool(rng.random() < 0.4),
        (np.array([1.6, 1.2, 0.9])[:blocks] * rng.uniform(0.9, 1.1, blocks)).tolist(),
        rng.uniform(0.4, 0.7, blocks).tolist(),
        ({2: 0.2, 3: 0.42}[gdim] * rng.uniform(0.6, 1.2, blocks)).tolist(),
        (10.0 ** rng.uniform(1.0, 3.0, blocks)).tolist(),
        [(str(rng.choice(kinds)), float(rng.uniform(0.1, 0.9))) for _ in range(blocks - 1)],
        str(rng.choice(BELOW)),
        str(rng.choice(ABOVE)),
        str(rng.choice(["none", "none", "number", "axis"])) if gdim == 2 else "none",
        not nonlinear and not second and bool(rng.random() < 0.3),
        bool(rng.random() < 0.5),
        between,
    )


def meshed(scene, comm, finer):
    """Mesh, cell tags 10 + k, facet tags: 10 k + 1 below, + 2 above, + 3 on the left of block k."""
    gmsh.initialize()
    if comm.rank == 0:
        gmsh.option.setNumber("General.Terminal", 0)
        occ, up, y = gmsh.model.occ, scene.gdim - 1, 0.0
        for k, (width, height) in enumerate(zip(scene.widths, scene.heights, strict=True)):
            corner = (1.0 + 0.1 * k, y, 0.0) if up == 1 else (1.0 + 0.1 * k, 0.05 * k, y)
            size = (width, height) if up == 1 else (width, 0.8 * width, height)
            block = occ.addRectangle(*corner, *size) if up == 1 else occ.addBox(*corner, *size)
            occ.synchronize()
            gmsh.model.addPhysicalGroup(scene.gdim, [block], 10 + k)
            for _, facet in gmsh.model.getBoundary([(scene.gdim, block)], oriented=False):
                box = np.reshape(gmsh.model.getBoundingBox(up, facet), (2, 3))
                flat, low = np.ptp(box, axis=0) < 1e-4, np.isclose(box[0], corner, atol=1e-4)
                if flat[up] or (flat[0] and low[0]):
                    tag = 10 * k + (3 if not flat[up] else 1 if low[up] else 2)
                    gmsh.model.addPhysicalGroup(up, [facet], tag)
            corners = gmsh.model.getBoundary([(scene.gdim, block)], recursive=True)
            gmsh.model.mesh.setSize(corners, scene.sizes[k] * (0.9 if finer else 1.0))
            if scene.quads:
                gmsh.model.mesh.setRecombine(2, block)
            y += height + scene.gaps[k]
        gmsh.option.setNumber("Mesh.SubdivisionAlgorithm", int(scene.quads))
        gmsh.model.mesh.generate(scene.gdim)
        if scene.order == 2 and scene.nonlinear:
            gmsh.model.mesh.setOrder(2)
    found = compat.model_to_mesh(gmsh.model, comm, 0, gdim=scene.gdim)
    gmsh.finalize()
    return found


class Posed:
    """A scene on its mesh, and its problem, of which each load step is taken by ``go``."""

    def __init__(self, scene, comm, solver="auto", finer=False):
        self.scene, self.comm, self.solver = scene, comm, solver
        self.domain, self.cell_tags, self.tags = meshed(scene, comm, finer)
        self.V = compat.function_space(self.domain, degree=scene.order, shape=(scene.gdim,))
        self.up, self.top = np.eye(scene.gdim)[-1], 10 * len(scene.E) - 8
        self.axis = scene.thickness == "axis"
        x = ufl.SpatialCoordinate(self.domain)
        self.t = {"axis": 2 * np.pi * x[0], "number": self.constant(0.7)}.get(scene.thickness, 1.0)
        self.thickness = {"axis": around_axis.around, "number": 0.7}.get(scene.thickness)
        self.E, self.mu_of_cells = (fem.Function(self.of_cells()) for _ in range(2))
        self.factor, self.pressure = self.constant(1.0), self.constant(0.0)
        self.gap, self.mu = self.constant(0.0), self.constant(0.0)
        self.pull = self.constant(np.zeros(scene.gdim))
        self.spring = self.constant(SPRING * min(scene.E))
        for kind, mu in scene.laws:
            self.mu.value = mu if kind == "Constant" else self.mu.value
            if kind == "of cells":
                self.mu_of_cells.x.array[:] = mu
        for k, E in enumerate(scene.E):
            self.E.x.array[compat.cell_dofs(self.of_cells())[self.cell_tags.find(10 + k)]] = E
        self.moved, self.nodal = fem.Function(self.V), []
        self._pose()
        self.problem = self.made()

    def constant(self, value):
        return fem.Constant(self.domain, value)

    def of_cells(self):
        return compat.function_space(self.domain, "DG", 0)

    def law(self, kind, mu):
        return {
            "tied": llm.Tied,
            "close": lambda: llm.Tied(close_gap=True),
            "gap": lambda: llm.Tied(gap=self.gap),
            "sliding": llm.Sliding,
            "frictionless": llm.Frictionless,
            "mu": lambda: llm.Coulomb(mu),
            "of x": lambda: llm.Coulomb(lambda x: mu * (1.0 + 0.3 * np.sin(3.0 * x[:, 0]))),
            "of cells": lambda: llm.Coulomb(self.mu_of_cells),
            "Constant": lambda: llm.Coulomb(self.mu),
            "cohesion": lambda: llm.Coulomb(mu, cohesion=0.002 * min(self.scene.E)),
            "dynamic": lambda: llm.Coulomb(mu, dynamic=0.7 * mu),
        }[kind]()

    def strain(self, u):
        """In space, in the plane, or around the axis."""
        r = ufl.SpatialCoordinate(self.domain)[0]
        return around_axis.gradient(u, r) if self.axis else ufl.grad(u)

    def _pose(self):
        """Forms, conditions and interfaces."""
        scene, v = self.scene, ufl.TestFunction(self.V)
        self.dx = ufl.dx(degree=2 * scene.order + 1, subdomain_data=self.cell_tags)
        E, self.u = self.factor * self.E, fem.Function(self.V)
        mu, lam = around_axis.lame(E, NU)
        u = self.u if scene.nonlinear else ufl.TrialFunction(self.V)
        eps, L = self.strain(u), self.t * ufl.inner(self.pull, v) * self.dx
        held = self.t * self.spring * ufl.inner(u, v) * self.dx
        if scene.nonlinear:
            W = finite_patch.energy(u, mu, lam)
            if self.axis:
                G = ufl.Identity(3) + eps
                W = mu / 2 * (ufl.inner(G, G) - 3 - 2 * ufl.ln(ufl.det(G)))
                W += lam / 2 * ufl.ln(ufl.det(G)) ** 2
            self.forms = ufl.derivative(self.t * W * self.dx, self.u, v) + held - L, self.u
        else:
            eps = ufl.sym(eps)
            sigma = 2 * mu * eps + lam * ufl.tr(eps) * ufl.Identity(eps.ufl_shape[0])
            a = self.t * ufl.inner(sigma, ufl.sym(self.strain(v))) * self.dx + held
            self.forms = a, L
        self.bcs, self.held, self.loads, self.interfaces = [], set(), [], []
        for k, law in enumerate(scene.laws):
            sides = (10 * k + 2, 10 * k + 11)
            self.meet(sides[::-1] if scene.swapped else sides, self.law(*law))
        gdim, none = scene.gdim, [None] * (scene.gdim - 1)
        height = sum(scene.heights) + sum(scene.gaps)
        point = np.append(np.full(gdim - 1, 1.6 if gdim == 2 else 0.5), height)
        floor = llm.RigidPlane(np.zeros(gdim), self.up)
        self.tool = llm.RigidPlane(point, -self.up, force=(*none, 0.0))
        self.mean = llm.MeanDisplacement((0.0,) * gdim)
        if scene.below == "clamped":
            self.hold(fem.Function(self.V), 1)
        else:
            law = llm.Coulomb(0.6) if scene.below == "plane" else llm.Tied()
            on = llm.MeanDisplacement((0.0,) * gdim) if scene.below == "mean" else floor
            self.meet((1, on), law)
        if scene.above == "moved":
            self.hold(self.moved, self.top)
        elif scene.above != "pressed":
            law = llm.Coulomb(0.7) if scene.above == "plane" else llm.Tied()
            self.meet((self.top, self.mean if scene.above == "mean" else self.tool), law)
        elif scene.nonlinear:
            self.loads = [llm.FreeSurfacePressure(
                self.tags, self.top, self.pressure, thickness=self.thickness
            )]  # fmt: skip
        if scene.guided:
            left = np.append(1.0, np.zeros(gdim - 1))
            self.meet((3, llm.RigidPlane(left, np.eye(gdim)[0])), llm.Sliding())

    def hold(self, value, tag):
        facets = self.tags.find(tag)
        dofs = fem.locate_dofs_topological(self.V, self.scene.gdim - 1, facets)
        self.bcs.append(fem.dirichletbc(value, dofs))
        self.held.add(tag // 10)

    def meet(self, sides, law):
        given = llm.Interface(self.tags, sides, law=law, thickness=self.thickness)
        self.interfaces.append(given)

    def made(self):
        options = {"bcs": self.bcs, "interfaces": self.interfaces, "solver": self.solver}
        if self.scene.nonlinear:
            return llm.NonlinearContactProblem(*self.forms, loads=self.loads, **options)
        return llm.ContactProblem(*self.forms, nodal_loads=self.nodal, **options)

    def go(self, down, along):
        """A load step."""
        scene, gdim = self.scene, self.scene.gdim
        height, least = sum(scene.heights), min(scene.E)
        sideways = STRAIN * along * (not self.axis) * np.eye(gdim)[0]
        way = 0.8 * sideways - STRAIN * down * height * self.up
        area = scene.widths[-1] * (2 * np.pi * 1.5 if self.axis else 1.0)
        self.gap.value = -0.2 * STRAIN * down
        self.moved.x.array[:] = np.tile(way, len(self.moved.x.array) // gdim)
        self.mean.mean = tuple(way)
        if scene.above in ("end", "plane"):
            self.tool.force = (*[None] * (gdim - 1), -STRAIN * least * down * area)
            self.tool.displacement = (*way[:-1], 0.0)
        if scene.above == "pressed":
            self.pressure.value = STRAIN * least * down
            self.pull.value = 0.2 * least * sideways
            if not scene.nonlinear:
                given = STRAIN * least * down
                options = {} if self.thickness is None else {"thickness": self.thickness}
                self.nodal[:] = [
                    llm.free_surface_load(self.V, self.tags, self.top, given, **options)
                ]
        self.problem.solve(increments=2 if along else 1)

    def imbalance(self):
        """Of bodies that no condition holds: forces of sides, loads and springs, over the largest
        force. Around the axis the component along it."""
        scene, total = self.scene, {}
        for interface, result in zip(self.interfaces, self.problem.results, strict=True):
            tags = [tag for tag in interface.sides if isinstance(tag, int)]
            for tag, side in zip(tags, result.sides, strict=True):
                total.setdefault(tag // 10, []).append(-side.force.sum(axis=0))
        size, worst = max(np.abs(f).max() for forces in total.values() for f in forces), 0.0
        for k, forces in total.items():
            if k in self.held or (k == len(scene.E) - 1 and scene.above == "pressed"):
                continue
            spring = self.t * (self.pull - self.spring * self.problem.u)
            found = [spring[i] * self.dx(10 + k) for i in range(scene.gdim)]
            acts = [self.comm.allreduce(fem.assemble_scalar(fem.form(f))) for f in found]
            left = np.abs(np.sum(forces, axis=0) + acts)
            worst = max(worst, (left[-1] if self.axis else left.max()) / size)
        return worst

    def told(self):
        """Numbers of all interfaces: resultants, sizes of nodal forces."""
        found = []
        for result in self.problem.results:
            found += np.ravel(result.resultant).tolist()
            found += [float(np.linalg.norm(side.force)) for side in result.sides]
        return found


def run(seed, comm, folder, solver="auto"):
    """Per load step the numbers of all interfaces, and the largest imbalance of a body."""
    scene = draw(seed)
    posed, numbers, imbalances = Posed(scene, comm, solver), [], []
    for k, step in enumerate(PATH):
        if k == 2:
            posed = between(posed, folder)
        posed.go(*step)
        numbers.append(posed.told())
        imbalances.append(posed.imbalance())
    posed.problem.destroy()
    return numbers, imbalances


def between(posed, folder):
    """What users do after a load step; the scene with which they go on."""
    scene, problem = posed.scene, posed.problem
    if scene.between == "saved":
        file = f"{folder}/{scene.seed}.npz"
        problem.save(file)
        problem.destroy()
        posed.u.x.array[:] = 0.0
        posed.problem = posed.made()
        posed.problem.load(file)
    elif scene.between == "transfer":
        fresh = Posed(scene, posed.comm, posed.solver, finer=True)
        llm.transfer(problem, fresh.problem)
        problem.destroy()
        return fresh
    elif scene.between == "modulus":
        posed.factor.value = 1.3
    elif scene.between == "held":
        posed.hold(fem.Function(posed.V), 3)
    elif scene.between == "reset" and not scene.nonlinear:
        problem.reset()
    elif scene.between == "mu":
        posed.mu.value *= 1.5
        posed.mu_of_cells.x.array[:] *= 1.5
    return posed
