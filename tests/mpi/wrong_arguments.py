"""Wrong arguments of all public functions, as one table: what is given, and what is answered.

Every entry is refused with the class and a pattern of its message; run as a script on several
ranks, rank 0 prints what every rank got. ``s`` is a scene that is made once, see ``Scene``.
"""

import json
import re
import sys
import tempfile
from functools import cached_property
from pathlib import Path

import bad_input
import finite_patch
import numpy as np
import patch2d
import scenes
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import classical, compat, plot, post

INPUT, ERROR = llm.ContactInputError, llm.ContactError
NAN, INF = float("nan"), float("inf")
FRAME_X = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 1.0, 1.0]]
FRAME_CELLS = [[0, 1, 2, 3]]
PIVOT = [[0.0, 0.0], [1.0, 0.0]], [[0, 1]]


class Scene:
    """Two blocks, their forms and a solved problem; wrong things to give in their place."""

    def __init__(self, comm):
        self.comm = comm
        self.V, self.tags = scenes.two_blocks(comm, 3, 2)
        self.mesh = self.V.mesh
        self.a, self.L = scenes.forms(self.V)
        self.u, self.v = ufl.TrialFunction(self.V), ufl.TestFunction(self.V)
        self.bcs = scenes.hold(self.V, scenes.SYMMETRY)
        self.interface = llm.Interface(self.tags, (2, 3))
        self.frame = llm.Frame(FRAME_X, FRAME_CELLS)
        self.flat = llm.Frame(*PIVOT)
        root = tempfile.mkdtemp() if comm.rank == 0 else None
        self.folder = Path(comm.bcast(root))
        self.file = self.folder / "file"
        if comm.rank == 0:
            self.file.write_text("no folder")
            (self.folder / "folder.png").mkdir()
            (self.folder / "folder.pvd").mkdir()
            (self.folder / "taken_0_0.vtu").mkdir()
        comm.barrier()

    def problem(self, a=None, L=None, **other):
        """A problem with something else in the place of what is right."""
        chosen = {"bcs": self.bcs, "interfaces": [self.interface]} | other
        a, L = self.a if a is None else a, self.L if L is None else L
        return llm.ContactProblem(a, L, **chosen)

    @cached_property
    def cells(self):
        """Cell tags that differ in every body."""
        index_map = self.mesh.topology.index_map(3)
        cells = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
        first = self.mesh.geometry.x[compat.cell_dofs(self.mesh.geometry)[:, 0]]
        return mesh.meshtags(self.mesh, 3, cells, np.where(first[:, 0] < 0.4, 1, 2).astype("i4"))

    def tags_of(self, tag):
        """The facets of one tag."""
        facets = self.tags.find(tag)
        return mesh.meshtags(self.mesh, 2, facets, np.full(len(facets), tag, dtype=np.int32))

    def law(self, law, sides=(2, 3), **options):
        held = ((2, scenes.on(2, 0.0)), *((k, scenes.on(2, z)) for k in (0, 1) for z in (0.0, 2.0)))
        interface = llm.Interface(self.tags, sides, law=law, **options)
        return self.problem(bcs=scenes.hold(self.V, held), interfaces=interface)

    @cached_property
    def bent(self):
        """Mesh, tags, displacement and residual of bodies at finite deformation."""
        ((domain, tags),) = patch2d.bodies(self.comm)
        V = compat.function_space(domain, shape=(2,))
        u = fem.Function(V)
        return domain, tags, u, finite_patch.residual(u, 1.0, 1.0)

    def nonlinear(self, F=None, u=None, **other):
        """A problem at finite deformation with something else in the place of what is right."""
        _, tags, right, form = self.bent
        sides = patch2d.FOUNDATION_TOP, patch2d.PUNCH_BOTTOM
        chosen = {"interfaces": llm.Interface(tags, sides, law=llm.Frictionless())} | other
        F, u = form if F is None else F, right if u is None else u
        return llm.NonlinearContactProblem(F, u, **chosen)

    def pressure(self, p=1.0, tag=patch2d.FOUNDATION_TOP, **more):
        return llm.FreeSurfacePressure(self.bent[1], tag, p, **more)

    def under(self, tag):
        return self.pressure(covered_by=(self.bent[1], tag))

    @cached_property
    def warm(self):
        """A problem of temperatures."""
        u, v = ufl.TrialFunction(self.scalar), ufl.TestFunction(self.scalar)
        a = (u * v + ufl.inner(ufl.grad(u), ufl.grad(v))) * ufl.dx
        return self.problem(a, fem.Constant(self.mesh, 1.0) * v * ufl.dx, bcs=[])

    @cached_property
    def second_order(self):
        V = compat.function_space(self.mesh, degree=2, shape=(3,))
        return self.problem(*scenes.forms(V), bcs=scenes.hold(V, scenes.SYMMETRY))

    @cached_property
    def of_mean(self):
        """A problem with a prescribed mean beside a tie."""
        mean = llm.Interface(self.tags, (4, llm.MeanDisplacement((None, None, 0.1))))
        return self.problem(interfaces=[self.interface, mean])

    @cached_property
    def solved(self):
        problem = self.problem()
        problem.solve()
        return problem

    def steps(self, problem, name, time=None):
        """Files of load steps, closed on all ranks whatever happens."""
        with post.LoadSteps(problem, self.path(name)) as files:
            files.write(time)

    @cached_property
    def unsolved(self):
        return self.problem()

    @cached_property
    def gone(self):
        problem = self.problem()
        problem.solve()
        problem.destroy()
        problem.destroy()
        return problem

    @cached_property
    def pressed(self):
        return self.law(llm.Frictionless())

    @cached_property
    def result(self):
        return self.solved.results[0]

    @cached_property
    def other(self):
        """Function space and tags of another mesh."""
        return scenes.two_blocks(self.comm, 2, 3)

    @cached_property
    def scalar(self):
        return compat.function_space(self.mesh)

    @cached_property
    def size(self):
        """A scalar expression on the mesh."""
        u = self.solved.u
        return ufl.sqrt(ufl.inner(u, u))

    def prisms(self):
        """Function space and tags of prisms; a mesh on every rank, since dolfinx shares none."""
        kind = mesh.CellType.prism
        domain = mesh.create_unit_cube(MPI.COMM_SELF, 2, 2, 2, cell_type=kind)
        tags = mesh.meshtags(domain, 2, np.zeros(1, np.int32), np.full(1, 2, np.int32))
        return compat.function_space(domain, shape=(3,)), tags

    def tagged(self, domain):
        dim = domain.topology.dim
        domain.topology.create_connectivity(dim - 1, dim)
        top = mesh.locate_entities_boundary(domain, dim - 1, lambda p: p[0] > 1 - 1e-9)
        tags = scenes.tags_from(domain, [top], [np.full(len(top), 2, np.int32)], dim - 1)
        shape = (domain.geometry.dim,)
        return compat.function_space(domain, shape=shape), tags

    def load(self, V, tags):
        return llm.free_surface_load(V, tags, 2, 1.0)

    def path(self, name):
        return self.folder / name

    @cached_property
    def pairs(self):
        """Arguments of the designs: a frame of one cell and points on it."""
        x = [np.array(FRAME_X), np.array(FRAME_X)]
        forces = [np.full(4, 0.25), np.full(4, 0.25)]
        at = [self.frame.locate(p) for p in x]
        N = [self.frame.interpolation(a) for a in at]
        return x, forces, N, [a.cell for a in at]

    def weights(self, **other):
        x, forces, N, cells = self.pairs
        s = self.frame.x[:, :2]
        chosen = {"frame": self.frame, "s": s, "N": N, "cells": cells, "forces": forces} | other
        return llm.design_weights(**chosen)

    def positions(self, **other):
        x, forces, _, _ = self.pairs
        return llm.design_positions(**{"frame": self.frame, "x": x, "forces": forces} | other)

    def surface_mesh(self):
        """Triangles in space."""
        x, quads = scenes.grid(2, 2)
        x = np.column_stack([x, 0.0 * x[:, 0]])
        cells = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])
        if self.comm.rank:
            x, cells = x[:0], cells[:0]
        return self.tagged(compat.create_mesh(self.comm, cells, x, "triangle"))

    def second_order_mesh(self):
        """A square of six-node triangles."""
        import gmsh

        gmsh.initialize()
        gmsh.option.setNumber("General.Terminal", 0)
        if self.comm.rank == 0:
            gmsh.model.occ.addRectangle(0.0, 0.0, 0.0, 1.0, 1.0)
            gmsh.model.occ.synchronize()
            gmsh.model.addPhysicalGroup(2, [1], 1)
            gmsh.model.addPhysicalGroup(1, [1], 2)
            gmsh.model.mesh.generate(2)
            gmsh.model.mesh.setOrder(2)
        domain = compat.model_to_mesh(gmsh.model, self.comm, 0, gdim=2)[0]
        gmsh.finalize()
        return self.tagged(domain)


COULOMB = [
    (f"Coulomb {mu!r}", INPUT, r"Coulomb: mu.*: give a finite number of at least 0", mu)
    for mu in ("0.3", None, -0.1, NAN, INF, [0.3], np.array([0.3, -0.4]), True, 1j, {}, 10**400)
]
CONDUCTANCES = [-0.1, NAN, INF, "2", None, True, [1.0]]
TABLE = [
    *[(f"Conductance {h!r}", INPUT, "Conductance: h.*: give a finite number of at least 0",
       lambda s, h=h: llm.Conductance(h)) for h in CONDUCTANCES],
    ("pressure_at", INPUT, "x=.*give .k, 3. positions",
     lambda s: s.result.pressure_at([[0.0, 1.0]])),
    *[(name, kind, words, lambda s, mu=mu: llm.Coulomb(mu)) for name, kind, words, mu in COULOMB],
    *[(name, kind, words, lambda s, make=make: make(s.comm))
      for name, (make, words, kind) in bad_input.CASES.items()],
]  # fmt: skip


def add(words, *calls, kind=INPUT):
    """Entries with one pattern."""
    TABLE.extend((f"{words} {len(TABLE)}", kind, words, call) for call in calls)


# Laws, obstacles, interfaces

add(
    "method=.*choose one of",
    lambda s: llm.Coulomb(0.1, method=3),
    lambda s: llm.Coulomb(0.1, method=["newton"]),
)
add(
    "Coulomb: dynamic.*: give a finite number of at least 0",
    lambda s: llm.Coulomb(0.1, dynamic=-0.1),
    lambda s: llm.Coulomb(0.1, dynamic="0.05"),
)
add(
    "Coulomb: (mu|cohesion|dynamic).*at least 0; interpolate a UFL expression into a Function",
    lambda s: llm.Coulomb(2.0 * fem.Constant(s.mesh, 0.3)),
    lambda s: llm.Coulomb(fem.Constant(s.mesh, (0.3, 0.3))),
    lambda s: llm.Coulomb(0.3, cohesion=ufl.SpatialCoordinate(s.mesh)[0]),
    lambda s: llm.Coulomb(0.3, dynamic=ufl.TrialFunction(s.scalar)),
)
add("Coulomb: mu=.*at least 0", lambda s: llm.Coulomb(fem.Constant(s.mesh, -0.3)))
add(
    "(mu|h)=Function.*complex values: give real ones",
    lambda s: llm.Coulomb(fem.Function(s.scalar, dtype=np.complex128)),
    lambda s: llm.Conductance(fem.Function(s.scalar, dtype=np.complex128)),
)
add(
    "values at points of a quadrature rule",
    lambda s: s.law(llm.Coulomb(fem.Function(compat.quadrature_space(s.mesh, 2)))).solve(),
)
add("Conductance: h.*interpolate", lambda s: llm.Conductance(ufl.SpatialCoordinate(s.mesh)[0]))
add(
    "a law's value at .* positions is .*give real numbers",
    lambda s: s.law(llm.Coulomb(lambda x: "rough")).solve(),
    lambda s: s.law(llm.Coulomb(lambda x: 0.3j * np.ones(len(x)))).solve(),
    lambda s: s.law(llm.Coulomb(0.3, cohesion=lambda x: None)).solve(),
)
add(
    "Tied: gap=.*give a finite number",
    lambda s: llm.Tied(gap=None),
    lambda s: llm.Tied(gap=1j),
    lambda s: llm.Tied(gap=ufl.SpatialCoordinate(s.mesh)[0]),
    lambda s: llm.Tied(gap=fem.Constant(s.mesh, (0.0, 0.0))),
)
add(
    "close_gap=.*give True or False",
    lambda s: llm.Tied(close_gap="no"),
    lambda s: llm.Tied(close_gap=1),
    lambda s: llm.Tied(None),
    lambda s: llm.Tied([True]),
)
add(
    "point=.*give 2 or 3 numbers",
    *(lambda s, x=x: llm.RigidPlane(x, (0, 0, 1)) for x in (
        0.0, None, "abc", (0, 0, 0, 0), (), (0, NAN, 0), (0, 0, 1j), ((0, 0, 0), (1, 1, 1)),
        (0, (1, 2), 0),
    )),
    lambda s: llm.RigidPlane(s.mesh, (0, 0, 1)),
    lambda s: llm.RigidPlane((True, False), (0, 1)),
)  # fmt: skip
add("normal=.*has no direction", lambda s: llm.RigidPlane((0, 0, 0), (0, 0, 0)))
add(
    "normal=.*give 3 numbers",
    *(lambda s, x=x: llm.RigidPlane((0, 0, 0), x) for x in ((0, 1), (0, INF, 1), "up")),
)
add(
    "axis=.*(give 3 numbers|no direction)",
    lambda s: llm.RigidCylinder((0, 0, 0), (0, 0, 0), 1.0),
    lambda s: llm.RigidCylinder((0, 0, 0), 2, 1.0),
)
add(
    "radius=.*give a positive, finite number",
    *(lambda s, x=x: llm.RigidSphere((0, 0), x) for x in (-1, 0, "1", INF, None, (1, 1), True)),
    lambda s: llm.RigidCylinder((0, 0, 0), (0, 0, 1), NAN),
)
add(
    "inside=.*give True or False",
    lambda s: llm.RigidSphere((0, 0), 1.0, inside="yes"),
    lambda s: llm.RigidSphere((0, 0), 1.0, inside=2),
)
add(
    "displacement=.*give [23] numbers",
    *(lambda s, x=x: llm.RigidPlane((0, 0, 0), (0, 0, 1), displacement=x) for x in (
        0.1, "down", (0, 0, NAN),
    )),
    lambda s: llm.RigidSphere((0, 0), 1.0, displacement=(1, 2, 3)),
)  # fmt: skip
add(
    "rotation=.*give (the|3 numbers|a)|rotation=nan",
    lambda s: llm.RigidPlane((0, 0), (0, 1), rotation=(0, 0, 1)),
    lambda s: llm.RigidPlane((0, 0, 0), (0, 0, 1), rotation=0.1),
    lambda s: llm.RigidPlane((0, 0), (0, 1), rotation=NAN),
)
add("pivot=1.0: give 2 numbers", lambda s: llm.RigidPlane((0, 0), (0, 1), pivot=1.0))
add(
    "moment=.*give (3 entries|a finite number)",
    lambda s: llm.RigidPlane((0, 0), (0, 1), moment=(1.0, 2.0)),
    lambda s: llm.RigidPlane((0, 0, 0), (0, 0, 1), moment=1.0),
    lambda s: llm.RigidPlane((0, 0, 0), (0, 0, 1), moment=(None, "far", 0.0)),
)
add("rotation=.*has both", lambda s: llm.RigidPlane((0, 0), (0, 1), moment=1.0, rotation=0.1))
add(
    "force=.*give 2( entries)?",
    lambda s: llm.RigidPlane((0, 0), (0, 1), force=-10.0),
    lambda s: llm.RigidPlane((0, 0), (0, 1), force=(None, "down")),
    lambda s: llm.RigidSphere((0, 0), 1.0, force=(1, 2, 3)),
)
add("1 surface node.s. lie at", lambda s: llm.RigidSphere((0, 0), 2.0).clearance(np.zeros((1, 2))))
add(
    "one must be a body",
    lambda s: llm.Interface(None, (llm.RigidSphere((0, 0), 1), llm.RigidSphere((9, 0), 1))),
)
add(
    "leave frame=None",
    lambda s: llm.Interface(None, (3, llm.RigidPlane((0, 0), (0, 1))), frame=s.flat),
)
add(
    "mesh=.*give a dolfinx_llm.Frame",
    lambda s: llm.RigidSurface(s.mesh),
    lambda s: llm.RigidSurface(None),
    lambda s: llm.RigidSurface(FRAME_X),
)
add(
    "sides.*give two facet tags",
    *(lambda s, x=x: llm.Interface(s.tags, x) for x in (
        ("2", "3"), (2.0, 3), (True, 3), (2, None), 2, "23", None, (2,), (2, 3, 4), {2: 3, 4: 5},
        ((), 3), (np.array([2, 5]), 3),
    )),
    lambda s: llm.Interface(s.tags, (s.tags, s.tags)),
    lambda s: llm.Interface(s.tags, ((s.tags, "2"), (s.tags, 3))),
)  # fmt: skip
add(
    "V=|function space",
    lambda s: llm.find_interfaces(None, []),
    lambda s: llm.find_interfaces(None, s.mesh),
    lambda s: llm.find_interfaces(None, [s.V, None]),
)
add(
    "(facet|cell)_tags=.*(give one for each|give dolfinx mesh tags)",
    lambda s: llm.find_interfaces(s.mesh, s.V),
    lambda s: llm.find_interfaces([s.tags, s.tags], s.V),
    lambda s: llm.find_interfaces(None, s.V, cell_tags="cells"),
)
add(
    "cell_tags of dimension 2: they must have 3",
    lambda s: llm.find_interfaces(None, s.V, cell_tags=s.tags),
)
add(
    "facet_tags: they belong to another mesh",
    lambda s: llm.find_interfaces(s.other[1], s.V),
)
add(
    "law.*=.*(choose Tied|give a dict of laws)",
    lambda s: llm.find_interfaces(None, s.V, law="tied"),
    lambda s: llm.find_interfaces(None, s.V, laws=llm.Tied()),
    lambda s: llm.find_interfaces(None, s.V, laws={}),
    lambda s: llm.find_interfaces(None, s.V, laws={3: llm.Tied()}, cell_tags=s.cells),
    lambda s: llm.find_interfaces(None, s.V, laws={(1, "a"): llm.Tied()}, cell_tags=s.cells),
    lambda s: llm.find_interfaces(None, s.V, laws={(1, 2): "tied"}, cell_tags=s.cells),
)
add(
    "give cell_tags|the cells of body 0 have the values .1, 2.",
    lambda s: llm.find_interfaces(None, s.V, laws={(1, 2): llm.Tied()}),
    lambda s: llm.find_interfaces(None, s.V, laws={(1, 2): llm.Tied()}, cell_tags=s.cells),
)
add(
    "laws: no body has the cell tags .77.; there are .1, 2",
    lambda s: llm.find_interfaces(None, s.V, laws={(1, 77): llm.Tied()}, cell_tags=s.cells),
)
add(
    "(distance|angle)=.*give (a positive length|an angle)",
    lambda s: llm.find_interfaces(None, s.V, distance=0.0),
    lambda s: llm.find_interfaces(None, s.V, distance=NAN),
    lambda s: llm.find_interfaces(None, s.V, angle=-0.1),
    lambda s: llm.find_interfaces(None, s.V, angle=2.0),
)
add(
    "no two of the 2 bodies have facets",
    lambda s: llm.find_interfaces(s.tags_of(4), s.V),
    kind=ERROR,
)
add(
    "facet tags=.*give dolfinx mesh tags",
    *(lambda s, x=x: llm.Interface(x, (2, 3)) for x in (None, "tags", np.array([2, 3]))),
    lambda s: llm.Interface(s.mesh, (2, 3)),
    lambda s: llm.Interface(s.V, (2, 3)),
    lambda s: llm.Interface(s.tags, ((2, 3), 4)),
    lambda s: llm.Interface(None, ((s.mesh, 2), (s.tags, 3))),
)
add(
    "law=.*choose",
    *(lambda s, x=x: llm.Interface(s.tags, (2, 3), law=x) for x in (None, llm.Tied, 0.3)),
)
add(
    "design=.*choose one of",
    *(lambda s, x=x: llm.Interface(s.tags, (2, 3), design=x) for x in (
        True, ["weights"], np.array([1, 2]),
    )),
)  # fmt: skip
add(
    "shift=.*(give a vector|two sides that are tied)",
    *(lambda s, x=x: llm.Interface(s.tags, (2, 3), shift=x) for x in (
        "x", 1.0, [[1.0, 0.0, 0.0]], [NAN, 0.0, 0.0], [None, 1.0, 0.0],
    )),
    lambda s: llm.Interface(s.tags, (2, 3), shift=(0, 0, 1), law=llm.Frictionless()),
)  # fmt: skip
add(
    "shift=.*as many numbers",
    lambda s: s.problem(interfaces=llm.Interface(s.tags, (2, 3), shift=(0.0, 1.0))),
)
add(
    "shift: periodic bodies",
    lambda s: s.nonlinear(
        interfaces=llm.Interface(
            s.bent[1], (patch2d.FOUNDATION_TOP, patch2d.PUNCH_BOTTOM), shift=(0.0, 0.0)
        )
    ),
)
add(
    "frame=.*give a dolfinx_llm.Frame",
    lambda s: llm.Interface(s.tags, (2, 3), frame=s.mesh),
    lambda s: llm.Interface(s.tags, (2, 3), frame=(FRAME_X, FRAME_CELLS)),
)

# What bodies remember

add(
    "(accepted|state|state: item|dt)=.*give",
    *(lambda s, given=given: s.solved.solve(**given) for given in (
        {"accepted": "update"}, {"accepted": 1}, {"state": 1.0}, {"state": ["u"]}, {"dt": 0.1},
        {"state": {}}, {"dt": [0.1]}, {"dt": "dt"},
    )),
    lambda s: s.solved.solve(dt=fem.Constant(s.mesh, 0.0)),
    lambda s: s.solved.solve(dt=fem.Constant(s.mesh, (1.0, 1.0))),
)  # fmt: skip
add(
    "rules(: key|: value)?=.*give a dict",
    *(lambda s, x=x: llm.Evolution(x) for x in (None, {}, [], "u", {"u": 1}, {1: 2.0})),
    lambda s: llm.Evolution({fem.Function(s.V): 1.0}),
    lambda s: llm.Evolution({fem.Function(s.V): "u"}),
)
add(
    "rules: the Function .* has the shape",
    lambda s: llm.Evolution({fem.Function(s.V): ufl.SpatialCoordinate(s.mesh)[0]}),
)
add(
    "rules: what the Function .* has a test or trial function",
    lambda s: llm.Evolution({fem.Function(s.V): s.v * s.v[0] * s.u[0]}),
    lambda s: llm.Evolution({fem.Function(s.V): s.v}),
)

add(
    "(old|new)=.*give a ContactProblem",
    *(lambda s, x=x: llm.transfer(x, s.solved) for x in (None, "old", 1)),
    lambda s: llm.transfer(s.solved, s.u),
)

# Frames

add(
    "frame: x(=.*give| must be)",
    *(lambda s, x=x: llm.Frame(x, FRAME_CELLS) for x in (
        "x", None, [[0, 1], [1]], np.array(FRAME_X) * 1j, [], [1.0, 2.0], np.zeros((4, 4)),
    )),
)  # fmt: skip
add(
    "frame: cells(=.*give| must be)",
    *(lambda s, x=x: llm.Frame(FRAME_X, x) for x in (
        [[0.5, 1, 2, 3]], "all", None, [], [0, 1, 2, 3], [[True, False, True, False]], [[0, 1]],
        [[0, 1, 2], [0, 2]],
    )),
)  # fmt: skip
add(
    "frame: cells name nodes",
    lambda s: llm.Frame(FRAME_X, [[0, 1, 2, 4]]),
    lambda s: llm.Frame(FRAME_X, [[-1, 1, 2, 3]]),
)
add(
    "frame: 1 coordinates are not finite",
    lambda s: llm.Frame([[0.0, 0.0, NAN], *FRAME_X[1:]], FRAME_CELLS),
)
add("frame: nodes .* belong to no cell", lambda s: llm.Frame(FRAME_X, [[0, 1, 2]]))
add(
    "frame: v=.*give",
    lambda s: llm.Frame(FRAME_X, FRAME_CELLS, v=[1, 2]),
    lambda s: llm.Frame(FRAME_X, FRAME_CELLS, v="moved"),
)
add(
    "points=.*give",
    *(lambda s, x=x: s.frame.locate(x) for x in ([[0.0, 1.0]], "here", [[0.0, NAN, 1.0]])),
)
add(
    "model=.*give gmsh.model",
    lambda s: llm.Frame.from_gmsh(None, 1, s.comm),
    lambda s: llm.Frame.from_gmsh("mine.msh", 1),
    lambda s: llm.Frame.from_gmsh(s.mesh, 1, s.comm),
)
add(
    "gdim=.*give 2 or 3",
    lambda s: llm.Frame.from_gmsh(None, 1, s.comm, gdim=4),
    lambda s: llm.Frame.from_gmsh(None, 1, s.comm, gdim="3"),
)
add(
    "physical_group=.*give the tag",
    lambda s: llm.Frame.from_gmsh(None, "top", s.comm),
    lambda s: llm.Frame.from_gmsh(None, 1.5),
)
add("comm=.*give an MPI communicator", lambda s: llm.Frame.from_gmsh(None, 1, 0))


@lambda f: add("physical group 1", f)
def gmsh_that_is_not_initialised(s):
    import gmsh

    llm.Frame.from_gmsh(gmsh.model, 1, s.comm)


# Problems

add(
    "a=.*give a bilinear UFL form",
    *(lambda s, x=x: s.problem(a=x) for x in ("a", 1.0, [])),
    lambda s: s.problem(a=fem.form(s.a)),
    lambda s: s.problem(a=[s.a, None], L=[s.L, s.L]),
    lambda s: s.problem(a=s.solved.K),
    lambda s: s.problem(a=s.a == s.L),
)
add(
    "L=.*give a linear UFL form",
    *(lambda s, x=x: s.problem(L=x) for x in (0.0, np.zeros(3), [])),
    lambda s: llm.ContactProblem(s.a, None, interfaces=s.interface),
    lambda s: s.problem(L=fem.form(s.L)),
    lambda s: s.problem(L=fem.Function(s.V)),
)
add(
    "form a must be bilinear, has [013]",
    lambda s: s.problem(a=ufl.Form([])),
    lambda s: s.problem(a=s.L),
    lambda s: s.problem(a=s.solved.u[0] * ufl.dx),
    lambda s: s.problem(a=s.u[0] * s.v[0] * ufl.Argument(s.V, 2)[0] * ufl.dx),
)
add(
    "form L must be linear, has [02]",
    lambda s: s.problem(L=s.a),
    lambda s: s.problem(L=ufl.Form([])),
    lambda s: s.problem(L=s.solved.u[0] * ufl.dx),
)
add("1 bilinear forms, 2 linear", lambda s: s.problem(a=[s.a], L=[s.L, s.L]))
add("two of the forms a live on one mesh", lambda s: s.problem(a=[s.a, s.a], L=[s.L, s.L]))
add(
    "0 of the forms L have a test function",
    lambda s: s.problem(L=scenes.forms(s.other[0])[1]),
    lambda s: s.problem(L=ufl.TestFunction(s.scalar) * ufl.dx),
)
add(
    "test and trial functions of two spaces",
    lambda s: s.problem(
        a=ufl.inner(ufl.TrialFunction(compat.function_space(s.mesh, shape=(3,))), s.v) * ufl.dx
    ),
    lambda s: s.problem(a=s.u[0] * ufl.TestFunction(s.scalar) * ufl.dx),
)
add(
    "(several meshes|cannot be compiled)",
    lambda s: s.problem(a=fem.Function(s.other[0])[0] * ufl.inner(s.u, s.v) * ufl.dx(s.mesh)),
)
add(
    "entity_maps(=.*does not fit|.*has none)",
    *(lambda s, x=x: s.problem(entity_maps=x) for x in (3, "", [3])),
)
add(
    "cannot be compiled",
    lambda s: s.problem(a=s.u[0] ** 2 * s.v[0] * ufl.dx),
    lambda s: s.problem(L=ufl.sqrt(s.v[0]) * ufl.dx),
)
add(
    r"no tags that tell where that is: give ufl.d[sx]\(subdomain_data=tags\)",
    lambda s: s.problem(L=s.v[0] * ufl.ds(4)),
    lambda s: s.problem(L=s.v[0] * ufl.dx + s.v[0] * ufl.ds((4, 5))),
    lambda s: s.problem(a=ufl.inner(s.u, s.v) * ufl.dx(1)),
    lambda s: s.nonlinear(F=s.bent[3] - ufl.TestFunction(s.bent[2].function_space)[0] * ufl.ds(4)),
)
add(
    "bcs(: item)?=.*give a list of Dirichlet",
    *(lambda s, x=x: s.problem(bcs=x) for x in (None, "fixed", [None], 0)),
    lambda s: s.problem(bcs=[s.bcs]),
    lambda s: s.problem(bcs=fem.Function(s.V)),
    lambda s: s.problem(bcs={"top": s.bcs}),
)
add(
    "Dirichlet condition belongs to none",
    lambda s: s.problem(bcs=scenes.hold(s.other[0], scenes.SYMMETRY)),
)
add(
    "interfaces(: item)?=.*give at least one",
    *(lambda s, x=x: s.problem(interfaces=x) for x in (None, [None], (2, 3), "top")),
    lambda s: s.problem(interfaces=[[s.interface]]),
)
add("give at least one", lambda s: s.problem(interfaces=[]))
add(
    "law=.*meets itself is not tied|law=.*Frictionless.. or Coulomb",
    *(lambda s, x=x: llm.SelfContact(s.tags, 3, law=x) for x in (llm.Tied(), "none")),
)
add("tag=.*give the facet tag", *(lambda s, x=x: llm.SelfContact(s.tags, x) for x in (None, 1.5)))
add("design=", lambda s: llm.SelfContact(s.tags, 3, design="positions"))
add("facet tags", lambda s: llm.SelfContact(None, 3))
add("at finite deformation alone", lambda s: s.problem(interfaces=llm.SelfContact(s.tags, 3)))
add("facet tags belong to none", lambda s: s.problem(interfaces=llm.Interface(s.other[1], (2, 3))))
add(
    "nodal_loads(: item)?=.*give a list of dolfinx Functions",
    *(lambda s, x=x: s.problem(nodal_loads=x) for x in (None, [1.0], np.zeros(3))),
    lambda s: s.problem(nodal_loads=s.L),
    lambda s: s.problem(nodal_loads=[[fem.Function(s.V)]]),
)
add(
    "nodal load",
    lambda s: s.problem(nodal_loads=fem.Function(s.scalar)),
    lambda s: s.problem(nodal_loads=fem.Function(s.other[0])),
)
add(
    "solver=.*choose one of",
    *(lambda s, x=x: s.problem(solver=x) for x in (None, "mumps", ["saddle"], 1)),
)
add(
    "petsc_options_prefix=.*give a word",
    *(lambda s, x=x: s.problem(petsc_options_prefix=x) for x in (None, "-llm_", 3, "my own")),
)
add(
    "petsc_options=.*give a dict",
    *(lambda s, x=x: s.problem(petsc_options=x) for x in ("-ksp_type cg", [("ksp_type", "cg")], 3)),
)
add(
    "petsc_options: name=.*no hyphen",
    *(lambda s, x=x: s.problem(petsc_options=x) for x in (
        {"-ksp_type": "cg"}, {1: "cg"}, {"": "cg"}, {"ksp type": "cg"},
    )),
)  # fmt: skip
add(
    'petsc_options: "ksp_rtol"=.*give a text',
    *(lambda s, x=x: s.problem(petsc_options=x) for x in (
        {"ksp_rtol": NAN}, {"ksp_rtol": [1e-8]}, {"ksp_rtol": {"value": 1e-8}},
    )),
)  # fmt: skip
add(
    "petsc_options: ksp_(max_it|rtol)=.*give",
    *(lambda s, x=x: s.problem(petsc_options=x) for x in (
        {"ksp_max_it": -5}, {"ksp_max_it": 1.5}, {"ksp_rtol": -1e-9},
    )),
)  # fmt: skip
add("did you mean 'cholesky'", lambda s: s.problem(petsc_options={"pc_type": "cholseky"}))
add("did you mean 'gmres'", lambda s: s.problem(petsc_options={"ksp_type": "gmers"}))
add(
    "'ksp_tpye' is no option.*did you mean 'ksp_type'",
    lambda s: s.problem(petsc_options={"ksp_tpye": "cg"}).solve(),
    lambda s: s.problem(petsc_options={"ksp_tpye": "cg"}, solver="condensed").solve(),
)
add(
    "'mat_mumps_icnlt_14' is no option",
    lambda s: s.problem(petsc_options={"mat_mumps_icnlt_14": 90}).solve(),
)
add(
    "PETSc cannot set up the solver with ksp_rtol='small'",
    lambda s: s.problem(petsc_options={"ksp_rtol": "small"}).solve(),
    lambda s: s.problem(petsc_options={"ksp_rtol": "small"}, solver="condensed").solve(),
)
add(
    "PETSc cannot set up the solver with pc_type='magic'",
    lambda s: s.problem(petsc_options={"pc_type": "magic"}, solver="saddle").solve(),
    lambda s: s.problem(petsc_options={"pc_type": "magic"}, solver="condensed").solve(),
)
add(
    "PETSc cannot set up the solver with pc_factor_mat_solver_type",
    lambda s: s.problem(petsc_options={"pc_factor_mat_solver_type": "mumsp"}).solve(),
)
add(
    "pc_type='jacobi': this form of the system is factorised",
    lambda s: s.problem(petsc_options={"pc_type": "jacobi"}, solver="saddle").solve(),
)
add(
    "increments=.*give an integer of at least 1",
    *(
        lambda s, n=n: s.pressed.solve(n)
        for n in (0, -1, 2.5, True, "3", INF, NAN, None, [2], np.array([1, 2]), 2.0)
    ),
)
add(
    "there is (no displacement|nothing to draw|nothing to write) yet",
    lambda s: s.unsolved.u,
    lambda s: s.unsolved.plot(s.path("x")),
    lambda s: s.steps(s.unsolved, "steps"),
    kind=ERROR,
)
add(
    "this ContactProblem has been destroyed",
    lambda s: s.gone.solve(),
    lambda s: s.gone.plot(s.path("x")),
    lambda s: s.gone.K,
    lambda s: s.gone.B.norm(),
    lambda s: s.gone.L_b.norm(),
    lambda s: s.gone.u,
    lambda s: s.gone.reset(),
    lambda s: s.gone.results[0],
    lambda s: len(s.gone.results),
    lambda s: print(s.gone),
    lambda s: classical.NodeToSegment(s.gone, slave=0),
    lambda s: classical.Elimination(s.gone),
    kind=ERROR,
)
add(
    "(folder|path)=.*give a path",
    *(lambda s, x=x: s.solved.plot(x) for x in (None, 3, "", ["out"], b"out")),
)
add(
    "cannot be written",
    lambda s: s.solved.plot(s.file),
    lambda s: s.solved.plot(s.file / "in"),
    lambda s: s.solved.plot("/proc/none/here"),
)
add(
    "field=.*choose one of",
    *(lambda s, x=x: s.solved.plot(s.folder, field=x) for x in ("gap", None, 0)),
)

# Meshes and function spaces

add("cells of the kind.* prism", lambda s: s.load(*s.prisms()))
add("surface or curve of dimension 2 in 3D", lambda s: s.load(*s.surface_mesh()))
add(
    "cells of the kind.* interval",
    lambda s: s.load(*s.tagged(mesh.create_unit_interval(s.comm, 3))),
)
add("cells of order 2", lambda s: s.load(*s.second_order_mesh()))
add(
    "V=.*give a dolfinx function space",
    lambda s: llm.free_surface_load(s.mesh, s.tags, 4, 1.0),
    lambda s: llm.free_surface_load(None, s.tags, 4, 1.0),
    lambda s: llm.free_surface_load(s.tags, s.V, 4, 1.0),
)
add(
    "facet tags=.*give dolfinx mesh tags",
    lambda s: llm.free_surface_load(s.V, s.mesh, 4, 1.0),
    lambda s: llm.free_surface_load(s.V, None, 4, 1.0),
    lambda s: llm.free_surface_load(s.V, s.tags, 4, 1.0, covered_by=(None, 3)),
)
add("facet tags belong to another mesh", lambda s: llm.free_surface_load(s.V, s.other[1], 4, 1.0))
add(
    "facet tag=.*give an integer",
    *(lambda s, x=x: llm.free_surface_load(s.V, s.tags, x, 1.0) for x in ("4", None, 4.0, True)),
)
add(
    "pressure=.*must be a finite number",
    *(lambda s, x=x: llm.free_surface_load(s.V, s.tags, 4, x) for x in ("high", None, INF, 1 + 1j)),
    lambda s: llm.free_surface_load(s.V, s.tags, 4, fem.Constant(s.mesh, 1.0)),
)
add(
    "covered_by.*give",
    *(lambda s, x=x: llm.free_surface_load(s.V, s.tags, 2, 1.0, covered_by=x) for x in (
        3, (), "punch",
    )),
    lambda s: llm.free_surface_load(s.V, s.tags, 2, 1.0, covered_by=(s.tags, "3")),
)  # fmt: skip

# Designs

add(
    "frame=.*give a dolfinx_llm.Frame",
    lambda s: s.weights(frame=None),
    lambda s: s.positions(frame=FRAME_X),
)
add("frame: lies in 2D", lambda s: s.positions(frame=s.flat))
add(
    "x=.*give a pair",
    *(lambda s, x=x: s.positions(x=x) for x in (
        None, [FRAME_X], [FRAME_X, [[0.0, 1.0]]], ["a", "b"], [np.full((4, 3), NAN)] * 2,
    )),
)  # fmt: skip
add(
    "forces=.*give a pair",
    *(lambda s, x=x: s.positions(forces=x) for x in (None, [1, 1], [np.ones(3)] * 2)),
    *(lambda s, x=x: s.weights(forces=x) for x in ([-np.ones(4)] * 2, [np.zeros(4)] * 2, "equal")),
)
add("min_angle=", *(lambda s, x=x: s.positions(min_angle=x) for x in ("25", -5.0, 170.0)))
add("max_angle=", lambda s: s.positions(max_angle=None), lambda s: s.positions(max_angle=400.0))
add("min_side=", lambda s: s.positions(min_side=-1.0), lambda s: s.positions(min_side="long"))
add("tol=", lambda s: s.positions(tol=0.0), lambda s: s.positions(tol=NAN))
add("seed=", *(lambda s, x=x: s.positions(seed=x) for x in (-1, 1.5, "x")))
add("starts=", lambda s: s.positions(starts=0), lambda s: s.positions(starts=INF))
add("s=.*give", lambda s: s.weights(s=None), lambda s: s.weights(s=np.zeros((4, 3))))
add("N=.*give a pair", lambda s: s.weights(N=None), lambda s: s.weights(N=[np.eye(4)] * 2))
add(
    "cells=.*give a pair",
    *(lambda s, x=x: s.weights(cells=x) for x in (
        None, [np.zeros(4, int) + 7] * 2, [np.zeros(4)] * 2,
    )),
)  # fmt: skip
add("keep=.*give a pair", lambda s: s.weights(keep=True), lambda s: s.weights(keep=[[0.5] * 4] * 2))

# Classical forms

add(
    "problem=.*give a ContactProblem",
    lambda s: classical.NodeToSegment(s.a, slave=0),
    lambda s: classical.Elimination(None),
    kind=INPUT,
)
add(
    "slave=.*choose side 0 or 1",
    *(lambda s, x=x: classical.NodeToSegment(s.solved, slave=x) for x in (2, "0", None, True)),
)
add(
    "components=.*choose one of",
    lambda s: classical.NodeToSegment(s.solved, slave=0, components="tangential"),
    lambda s: classical.NodeToSegment(s.solved, slave=0, components=None),
)
add(
    "petsc_options=.*give a dict",
    lambda s: classical.NodeToSegment(s.solved, slave=0, petsc_options="cg"),
    lambda s: classical.Elimination(s.solved, petsc_options=["cg"]),
)
add(
    "for displacements of first order",
    lambda s: classical.NodeToSegment(s.warm, slave=0),
    lambda s: classical.NodeToSegment(s.second_order, slave=0),
)
add("prescribed mean has no frame", lambda s: classical.Elimination(s.of_mean))
add(
    "Tied\\(\\) only",
    lambda s: classical.NodeToSegment(s.pressed, slave=0),
    lambda s: classical.Elimination(s.pressed),
)
add(
    "Q=.*PETSc matrix",
    lambda s: classical.constraint_stats(None, 3),
    lambda s: classical.constraint_stats(np.eye(3), 3),
)
add(
    "gdim=.*give 2 or 3",
    lambda s: classical.constraint_stats(s.solved.K, 5),
    lambda s: classical.constraint_stats(s.solved.K, "3"),
)


@lambda f: add("this classical form has been destroyed", f, kind=ERROR)
def classical_form_after_its_end(s):
    ties = classical.NodeToSegment(s.solved, slave=0)
    ties.destroy()
    ties.destroy()
    ties.solve()


# Values, files and pictures

add(
    "sigma=.*give a UFL expression of shape",
    *(lambda s, x=x: post.von_mises(x) for x in (None, np.eye(3), ufl.Identity(2))),
    lambda s: post.von_mises(ufl.grad(s.solved.u)[0, :]),
)
add(
    "expression=.*give a scalar UFL expression",
    lambda s: post.cell_maximum(1.0, s.mesh),
    lambda s: post.cell_maximum(s.solved.u, s.mesh),
    lambda s: post.cell_maximum(None, s.mesh),
    lambda s: post.cell_maximum(s.u[0], s.mesh),
    lambda s: post.at_quadrature_points("u", s.mesh),
    lambda s: post.cell_maximum(s.a, s.mesh),
)
add("expression=.*same mesh", lambda s: post.cell_maximum(fem.Function(s.other[0])[0], s.mesh))
add(
    "mesh=.*give a dolfinx mesh",
    lambda s: post.cell_maximum(s.size, None),
    lambda s: post.at_quadrature_points(s.size, s.V),
)
add(
    "degree=.*give an integer from 0 to 30",
    *(lambda s, x=x: post.cell_maximum(s.size, s.mesh, x) for x in (-1, "2", 99)),
    lambda s: post.at_quadrature_points(s.size, s.mesh, 1.5),
)
add(
    "u=.*give the displacement",
    lambda s: post.write_bodies(s.path("u.pvd"), None),
    lambda s: post.write_bodies(s.path("u.pvd"), []),
    lambda s: post.write_bodies(s.path("u.pvd"), [s.solved.u, 3]),
    lambda s: plot.bodies(s.V, s.size, s.path("u.png")),
)
add(
    "vector space of first or second order",
    lambda s: post.write_bodies(
        s.path("u.pvd"), fem.Function(compat.function_space(s.mesh, "DG", 0))
    ),
)
add(
    "must end on .pvd or .bp or .vtkhdf",
    lambda s: post.write_bodies(s.path("u.vtk"), s.solved.u),
    lambda s: post.write_bodies(s.path("u"), s.solved.u),
)
add(
    "seconds=.*give seconds, from 0.01 to 600",
    *(lambda s, x=x: plot.Film(s.solved, s.path("f.gif"), seconds=x) for x in (-1, 0, 656, "1")),
)
add(
    "about=.*give a point, 3 numbers",
    *(lambda s, x=x: s.result.moment(x) for x in ("a", 2.0, (0.0, 0.0), (0.0, 0.0, NAN))),
)
add(
    "path=.*give a path",
    lambda s: post.write_bodies(None, s.solved.u),
    lambda s: post.write_bodies(3, s.solved.u),
    lambda s: post.write_csv(None, ["a"], [[1]]),
    lambda s: plot.interface(s.result, 1),
    lambda s: plot.curves([("a", "-", [1], [2])], None),
)
add(
    "cannot be written",
    lambda s: post.write_bodies(s.file / "u.pvd", s.solved.u),
    lambda s: post.write_bodies(s.path("folder.pvd"), s.solved.u),
    lambda s: post.write_bodies(s.path("taken.pvd"), s.solved.u),
    lambda s: post.write_bodies("/proc/none/u.pvd", s.solved.u),
    lambda s: post.write_interface(s.file, s.result),
    lambda s: post.write_csv(s.file / "t.csv", ["a"], [[1]]),
    lambda s: plot.interface(s.result, s.file / "i.png"),
    lambda s: plot.interface(s.result, s.path("folder.png")),
    lambda s: plot.bodies(s.solved.u, s.size, s.file / "u.png"),
    lambda s: plot.frame_design(s.result, None, s.file / "f.png"),
    lambda s: plot.curves([("a", "-", [1], [2])], s.file / "c.png"),
    lambda s: post.LoadSteps(s.solved, s.file),
    lambda s: post.LoadSteps(s.solved, "/proc/none"),
)
add(
    "cell_fields(: name)?=.*give a dict",
    lambda s: post.write_bodies(s.path("u.pvd"), s.solved.u, [s.size]),
    lambda s: post.write_bodies(s.path("u.pvd"), s.solved.u, {1: s.size}),
    lambda s: post.write_bodies(s.path("u.pvd"), s.solved.u, "size"),
    lambda s: post.LoadSteps(s.solved, s.path("w"), cell_fields=lambda u: [u[0]]),
)
add(
    "cell_fields=.*a list with a dict for each mesh",
    lambda s: post.write_bodies(s.path("u.pvd"), [s.solved.u], []),
    lambda s: post.write_bodies(s.path("u.pvd"), [s.solved.u], {"x": s.size}),
)
add(
    "expression=.*give a scalar",
    lambda s: post.write_bodies(s.path("u.pvd"), s.solved.u, {"u": s.solved.u}),
    lambda s: plot.bodies(s.solved.u, s.solved.u, s.path("u.png")),
)
add(
    "result=.*give a result",
    lambda s: post.interface_fields(None),
    lambda s: post.interface_fields(s.solved),
    lambda s: post.write_interface(s.folder, [s.result]),
    lambda s: plot.interface(s.solved, s.path("i.png")),
    lambda s: plot.frame_design(None, None, s.path("f.png")),
)
add(
    "folder=.*give a path",
    lambda s: post.write_interface(None, s.result),
    lambda s: post.LoadSteps(s.solved, None),
)
add(
    "header=|rows",
    *(lambda s, x=x: post.write_csv(s.path("t.csv"), ["a"], x) for x in ([[1, 2]], [1], None)),
    lambda s: post.write_csv(s.path("t.csv"), None, [[1]]),
)
add(
    "problem=.*give a ContactProblem",
    lambda s: post.LoadSteps(s.mesh, s.path("w")),
    lambda s: post.LoadSteps(None, s.path("w")),
)
add(
    "suffix=.*choose one of",
    lambda s: post.LoadSteps(s.solved, s.path("w"), suffix=".vtk"),
    lambda s: post.LoadSteps(s.solved, s.path("w"), suffix=None),
)
add("cell_fields=.*give a function", lambda s: post.LoadSteps(s.solved, s.path("w"), cell_fields=3))
add(
    "time=.*give a finite number",
    lambda s: s.steps(s.solved, "w", "now"),
    lambda s: s.steps(s.solved, "w", NAN),
)
add(
    "field=.*choose one of",
    lambda s: plot.interface(s.result, s.path("i.png"), "force"),
    lambda s: plot.interface(s.result, s.path("i.png"), None),
)
add(
    "before=.*give a dolfinx_llm.Frame",
    lambda s: plot.frame_design(s.result, s.mesh, s.path("f.png")),
)
add("drawn in 3D", lambda s: plot.frame_design(s.result, s.flat, s.path("f.png")))
add(
    "must end on",
    lambda s: plot.interface(s.result, s.path("i.txt")),
    lambda s: plot.bodies(s.solved.u, s.size, s.path("u")),
)
add(
    "label=|scale=",
    lambda s: plot.bodies(s.solved.u, s.size, s.path("u.png"), label=None),
    lambda s: plot.bodies(s.solved.u, s.size, s.path("u.png"), scale="big"),
    lambda s: plot.bodies(s.solved.u, s.size, s.path("u.png"), scale=NAN),
)
add(
    "lines",
    *(lambda s, x=x: plot.curves(x, s.path("c.png")) for x in (
        [], 3, [("a", "-", [1])], [("a", "-", [1], [1, 2])], [("a", "-", ["x"], [1])],
        [("a", "zigzag", [1], [1])], [(1, "-", [1], [1])],
    )),
)  # fmt: skip
add("title=.*give a text", lambda s: plot.curves([("a", "-", [1], [1])], s.path("c.png"), title=3))
add("log=.*give True", lambda s: plot.curves([("a", "-", [1], [1])], s.path("c.png"), log=3))


@lambda f: add("these files are closed", f)
def files_that_are_closed(s):
    files = post.LoadSteps(s.solved, s.path("closed"))
    files.close()
    files.close()
    files.write()


# Finite deformation.

add(
    "give the Function u of the displacement",
    lambda s: s.nonlinear(u="u"),
    lambda s: s.nonlinear(u=[]),
    lambda s: s.nonlinear(u=[s.bent[2], s.bent[2]]),
)
add(
    "give a residual form",
    lambda s: s.nonlinear(F=3),
    lambda s: s.nonlinear(F=s.a),
    lambda s: s.nonlinear(F=s.L),
)
add(
    "give the derivative of F",
    lambda s: s.nonlinear(J=3),
    lambda s: s.nonlinear(J=s.bent[3]),
    lambda s: s.nonlinear(J=s.a),
)
add(
    r"a form F does not depend on its u, the Function \w+; it has \[",
    lambda s: s.nonlinear(u=fem.Function(s.bent[2].function_space)),
)


@lambda f: add(r"\d+ of \d+ free displacements have no stiffness", f)
def bodies_without_stiffness(s):
    domain, _, u, _ = s.bent
    none = fem.Constant(domain, 0.0)
    energy = finite_patch.energy(u, none, none)
    F = ufl.derivative(energy * ufl.dx, u, ufl.TestFunction(u.function_space))
    s.nonlinear(F).solve()


def lost_node(s, solves, where=NAN):
    """A node of a rank is nowhere, before or after a solve."""
    V, tags = scenes.two_blocks(s.comm)
    problem = scenes.block_problem(V, tags) if solves else None
    if solves:
        problem.solve()
    V.mesh.geometry.x[pick(s, [], [0])] = where
    return problem.solve() if solves else scenes.block_problem(V, tags)


def lost_bent_node(s):
    domain, tags, *_ = s.bent
    V = compat.function_space(patch2d.bodies(s.comm)[0][0], shape=(2,))
    u = fem.Function(V)
    V.mesh.geometry.x[pick(s, [], [0])] = INF
    F = ufl.inner(ufl.grad(u), ufl.grad(ufl.TestFunction(V))) * ufl.dx
    return llm.NonlinearContactProblem(F, u)


add(
    r"positions of 1 node.s. of a mesh are NaN or infinite",
    lambda s: lost_node(s, False),
    lambda s: lost_node(s, True),
    lost_bent_node,
)
add(
    "a Dirichlet condition has complex values",
    lambda s: s.problem(
        bcs=[fem.dirichletbc(np.zeros(3, complex), np.zeros(1, np.int32), s.V), *s.bcs]
    ),
)
add(
    "nodal load .*: complex values",
    lambda s: s.problem(nodal_loads=fem.Function(s.V, dtype=np.complex128)),
)


add(
    "petsc_options: 'foo' is no option that this solver",
    lambda s: s.nonlinear(solver="saddle", petsc_options={"foo": 1}).solve(),
)


@lambda f: add(r"has 4 argument.s.: of a ufl.MixedFunctionSpace. Take .* mixed element", f)
def form_of_parts(s):
    v, u = ([ufl.Argument(s.V, k, part) for part in (0, 1)] for k in (0, 1))
    s.problem(a=sum(ufl.inner(u[i], v[i]) * ufl.dx for i in (0, 1)))


@lambda f: add(r"^\d+ values that the Dirichlet conditions prescribe are NaN or infinite", f)
def nan_in_a_bent_support(s):
    V = s.bent[2].function_space
    held, dofs = fem.Function(V), fem.locate_dofs_geometrical(V, scenes.on(1, 0.0))
    held.x.array[:] = NAN
    s.nonlinear(bcs=[fem.dirichletbc(held, dofs)]).solve()


def loosely_solved(s, law, rtol):
    held = ((2, scenes.on(2, 0.0)), *((k, scenes.on(2, z)) for k in (0, 1) for z in (0.0, 2.0)))
    s.problem(
        bcs=scenes.hold(s.V, held),
        interfaces=llm.Interface(s.tags, (2, 3), law=law),
        nodal_loads=llm.free_surface_load(s.V, s.tags, 4, 1.0),
        solver="condensed",
        petsc_options={"ksp_type": "cg", "pc_type": "jacobi", "ksp_rtol": rtol},
    ).solve()


add(
    r"ksp_rtol=0.00[0-9]+: steps solved so loosely",
    lambda s: loosely_solved(s, llm.Frictionless(), 1e-4),
    kind=ERROR,
)
add(
    r"e-0[1-3] of the forces' size is left .*let the solver stop",
    lambda s: loosely_solved(s, llm.Tied(), 0.1),
    kind=ERROR,
)


def several(s, *pairs):
    """Interfaces at finite deformation, each of two sides."""
    law = llm.Frictionless()
    return s.nonlinear(interfaces=[llm.Interface(s.bent[1], sides, law=law) for sides in pairs])


TOP, UNDER = patch2d.FOUNDATION_TOP, patch2d.PUNCH_BOTTOM
BELOW = llm.RigidPlane((0.0, -9.0), (0.0, 1.0))
add(
    "facets of both sides in common: give each pair of surfaces once",
    lambda s: several(s, (TOP, UNDER), (UNDER, TOP)),
    lambda s: several(s, (TOP, UNDER), (TOP, UNDER)),
)
add(
    "are of the same obstacle and have .* facets in common",
    lambda s: several(s, (UNDER, BELOW), (BELOW, UNDER)),
)
PUSHED = llm.RigidPlane((0.0, -9.0), (0.0, 1.0), force=(None, 1.0))
add(
    "are of the same obstacle, which is under a force: each would bear all of it",
    lambda s: several(s, (UNDER, PUSHED), (TOP, PUSHED)),
)
add(
    "are of a surface that meets itself and have .* facets in common",
    lambda s: s.nonlinear(
        interfaces=[llm.SelfContact(s.bent[1], TOP, law=llm.Frictionless()) for _ in range(2)]
    ),
)
CROWN = patch2d.PUNCH_TOP
add("point the same way", lambda s: several(s, (TOP, CROWN)), kind=ERROR)
add(
    "of tag 3 lie on the RigidPlane or inside of it and face away, and none faces it",
    lambda s: several(s, (TOP, UNDER), (CROWN, llm.RigidPlane((0.0, 2.0), (0.0, 1.0)))),
    lambda s: several(s, (CROWN, llm.RigidPlane((0.0, 2.5), (0.0, 1.0)))),
    kind=ERROR,
)
add(
    "lie inside of the RigidPlane at the start, the deepest .* by 1.5: the body lies inside",
    lambda s: several(s, (CROWN, llm.RigidPlane((0.0, 0.5), (0.0, -1.0)))),
    kind=ERROR,
)


@lambda f: add(
    "lie inside of the body of tag [12] at the start, .* by 0.7.* so deep", f, kind=ERROR
)
def bodies_inside_of_each_other(s):
    domain, _, right, _ = s.bent
    u, one = fem.Function(right.function_space), fem.Constant(domain, 1.0)
    x = u.function_space.tabulate_dof_coordinates()
    of = compat.cell_dofs(u.function_space)
    for cell in of[x[of].mean(axis=1)[:, 1] > 1.0]:
        u.x.array[2 * cell + 1] = -0.7
    F = ufl.derivative(
        finite_patch.energy(u, one, one) * ufl.dx, u, ufl.TestFunction(u.function_space)
    )
    s.nonlinear(F, u)


def stepper(s, rho=1.0, dt=0.1, scheme="newmark", **other):
    """Steps in time of the two blocks."""
    law = llm.Tied() if scheme == "newmark" else llm.Frictionless()
    chosen = {"bcs": s.bcs, "interfaces": llm.Interface(s.tags, (2, 3), law=law)} | other
    return llm.TimeStepper(rho, s.a, s.L, dt=dt, scheme=scheme, **chosen)


def dense(s, value):
    """A density that varies from 1 to a value."""
    rho = fem.Function(s.scalar)
    rho.interpolate(lambda x: 1.0 + (value - 1.0) * x[0])
    return rho


add(
    "rho=.*give a positive number",
    *(lambda s, x=x: stepper(s, x) for x in (0.0, -1.0, NAN, "steel", None, 1j, [1.0, 2.0])),
    *(lambda s, x=x: stepper(s, fem.Constant(s.mesh, x)) for x in (0.0, -1.0, NAN)),
    lambda s: stepper(s, ufl.TrialFunction(s.scalar)),
    lambda s: stepper(s, s.solved.u),
)
add(
    "rho: .* of the masses are negative or NaN",
    lambda s: stepper(s, dense(s, -3.0)),
    lambda s: stepper(s, dense(s, NAN)),
    lambda s: stepper(s, dense(s, -3.0), scheme="massless"),
)
add("rho: all masses are 0", lambda s: stepper(s, fem.Function(s.scalar), scheme="massless"))
add(
    "rho: the Function .* is of another mesh",
    lambda s: stepper(s, fem.Function(compat.function_space(s.other[0].mesh))),
)
add("accepted=.*give a function of the stepper", lambda s: stepper(s, accepted=1))
add("dt=.*give a positive number", *(lambda s, x=x: stepper(s, dt=x) for x in (1e-300, 1e300, -1)))
add("J: .* leave J out", lambda s: stepper(s, J=s.a))
add("forms J", lambda s: s.nonlinear(J=[]))
add("solver=", lambda s: s.nonlinear(solver="magic"))
add("petsc_options", lambda s: s.nonlinear(petsc_options=3))
add("nodal_loads", lambda s: s.nonlinear(nodal_loads=[3]))
add("a nodal load lives on none", lambda s: s.nonlinear(nodal_loads=[s.solved.u]))
add("loads", lambda s: s.nonlinear(loads=3), lambda s: s.nonlinear(loads=[s.bent[2]]))
add(
    "none of the",
    lambda s: s.nonlinear(interfaces=s.interface),
    lambda s: s.nonlinear(loads=llm.FreeSurfacePressure(s.tags, 4, 1.0)),
    lambda s: s.nonlinear(bcs=s.bcs),
)
add("facet", lambda s: s.nonlinear(loads=s.pressure(tag=99)))
add(
    "no interface has both",
    lambda s: s.nonlinear(loads=s.under(patch2d.PUNCH_TOP)),
    lambda s: s.nonlinear(loads=s.under(patch2d.PUNCH_BOTTOM), interfaces=[]),
)


def in_each_other(s):
    """Supports prescribe both sides of an interface."""
    _, tags, u, _ = s.bent
    V, bcs = u.function_space, []
    for tag, motion in ((patch2d.FOUNDATION_TOP, 0.0), (patch2d.PUNCH_BOTTOM, -0.1)):
        dofs = fem.locate_dofs_topological(V, 1, tags.indices[tags.values == tag])
        bcs.append(fem.dirichletbc(np.array([0.0, motion]), dofs, V))
    s.nonlinear(bcs=bcs).solve()


add("supports hold both sides at .* by up to 0.1, there at", in_each_other, kind=ERROR)


def bent_end(s, end):
    """At finite deformation."""
    sides = patch2d.FOUNDATION_TOP, end
    return s.nonlinear(interfaces=llm.Interface(s.bent[1], sides, law=llm.Tied()))


add("increments=", *(lambda s, x=x: s.nonlinear().solve(x) for x in (0, "2", INF)))

# Wrong on one rank alone: on all of them an error, and none waits.

ONE_RANK = []


def one(words, *calls, kind=INPUT):
    """Entries whose argument ``w`` is wrong on the last rank only."""
    ONE_RANK.extend((f"one rank: {words} {len(ONE_RANK)}", kind, words, call) for call in calls)


def pick(s, right, wrong):
    return wrong if s.comm.rank == s.comm.size - 1 else right


one("bcs: item=", lambda s: s.problem(bcs=pick(s, s.bcs, [*s.bcs, None])))
one("solver=", lambda s: s.problem(solver=pick(s, "saddle", "magic")))
one("L=", lambda s: s.problem(L=pick(s, s.L, "none")))
one("nodal_loads", lambda s: s.problem(nodal_loads=pick(s, [], None)))
one("petsc_options", lambda s: s.problem(petsc_options=pick(s, None, {"-ksp_type": "cg"})))
one("increments=", lambda s: s.pressed.solve(pick(s, 1, 0)))
one("field=", lambda s: s.solved.plot(s.folder, pick(s, "status", "gap")))
one("folder=", lambda s: s.solved.plot(pick(s, s.folder, None)))
one("pressure=", lambda s: llm.free_surface_load(s.V, s.tags, 4, pick(s, 1.0, NAN)))
one("facet tag=", lambda s: llm.free_surface_load(s.V, s.tags, pick(s, 4, "4"), 1.0))
one("slave=", lambda s: classical.NodeToSegment(s.solved, slave=pick(s, 0, 7)))
one("cell_fields=", lambda s: post.write_bodies(s.path("u.pvd"), s.solved.u, pick(s, None, 3)))
one("must end on", lambda s: post.write_bodies(s.path(pick(s, "u.pvd", "u.x")), s.solved.u))
one(
    "cannot be written",
    lambda s: post.write_bodies(pick(s, s.folder, s.file) / "u.pvd", s.solved.u),
)
one("time=", lambda s: s.steps(s.solved, "one", pick(s, 1.0, NAN)))
one("give the derivative of F", lambda s: s.nonlinear(J=pick(s, None, 3)))
one("give the Function u", lambda s: s.nonlinear(u=pick(s, None, [])))
one("loads", lambda s: s.nonlinear(loads=pick(s, (), 3)))


@lambda f: one("finite", f)
def pressure_that_is_no_number(s):
    problem = s.nonlinear(loads=s.pressure(p := fem.Constant(s.bent[0], 1.0)))
    p.value = pick(s, 1.0, NAN)
    problem.solve()


one("increments=", lambda s: s.nonlinear().solve(pick(s, 1, 0)))

# Different on the last rank, though right by itself.


def failing(s, value=0.1):
    """A function of positions that fails on the last rank only."""

    def rough(x):
        return np.full(len(x), value / pick(s, 1.0, 0))

    return rough


class Broken(llm.Law):
    """A law that fails on the last rank when it is asked for what is named."""

    components, gives = "normal", True

    def __init__(self, s, where):
        self.s, self.where = s, where

    def _asked(self, where):
        return 1.0 / (where != self.where or pick(self.s, True, False))

    def start(self, nodes):
        return {"one": np.full(len(nodes.x), self._asked("start"))}

    def force(self, nodes):
        k = self._asked("force") * nodes.area[:, None]
        return k * nodes.jump, k

    def end_step(self, nodes):
        self._asked("end_step")
        return nodes.history


def broken(s, where, make):
    """A problem with such a law, solved."""
    law = Broken(s, where)
    if make == "linear":
        return s.law(law).solve()
    sides = patch2d.FOUNDATION_TOP, patch2d.PUNCH_BOTTOM
    return s.nonlinear(interfaces=llm.Interface(s.bent[1], sides, law=law)).solve()


def rough(s, law):
    sides = patch2d.FOUNDATION_TOP, patch2d.PUNCH_BOTTOM
    return s.nonlinear(interfaces=llm.Interface(s.bent[1], sides, law=law))


one(
    "division by zero",
    lambda s: s.law(llm.Coulomb(failing(s))).solve(),
    lambda s: s.law(llm.Coulomb(0.1, cohesion=failing(s))).solve(),
    lambda s: rough(s, llm.Coulomb(failing(s))),
    lambda s: s.law(llm.Tied()).solve(accepted=lambda problem: 1.0 / pick(s, 1.0, 0)),
    *(lambda s, x=x: broken(s, *x) for x in (
        ("start", "linear"), ("force", "linear"), ("end_step", "linear"), ("start", "bent"),
        ("force", "bent"),
    )),
    kind=ZeroDivisionError,
)  # fmt: skip


DIFFERENT = []


def differ(words, *calls):
    DIFFERENT.extend((f"differ: {words} {len(DIFFERENT)}", INPUT, words, c) for c in calls)


differ(
    "solver and PETSc options must be the same on all ranks",
    lambda s: s.problem(solver=pick(s, "saddle", "condensed")),
    lambda s: s.problem(petsc_options=pick(s, None, {"ksp_rtol": 1e-9})),
)
differ(
    "interfaces must be the same on all ranks",
    lambda s: s.law(pick(s, llm.Coulomb(0.3), llm.Coulomb(0.4))),
    lambda s: s.law(llm.Tied(), sides=pick(s, (2, 3), (3, 2))),
    lambda s: s.law(llm.Tied(), thickness=pick(s, 2.0, 3.0)),
)


def changed_on_one(s):
    weight = fem.Constant(s.mesh, 1.0)
    problem = s.problem(L=weight * s.L)
    weight.value = pick(s, 1.0, 2.0)  # as by `assemble_scalar`, where its sum is forgotten
    problem.solve()


def pulled_on_one(s):
    domain, _, u, form = s.bent
    pull = fem.Constant(domain, (0.1, pick(s, 0.0, 0.1)))
    s.nonlinear(F=form - ufl.inner(pull, ufl.TestFunction(u.function_space)) * ufl.dx).solve()


differ(
    r"Constants of the forms .* the same on all ranks: rank 0 has \[.*\], rank . has \[",
    changed_on_one,
    pulled_on_one,
    lambda s: s.problem(a=fem.Constant(s.mesh, pick(s, 1.0, 2.0)) * s.a),
)
differ("rho must be the same", lambda s: stepper(s, pick(s, 1.0, 2.0)))
differ("increments must be the same", lambda s: s.pressed.solve(pick(s, 1, 2)))


@lambda f: differ("motions of and forces on obstacles must be the same", f)
def mean_that_is_let_go(s):
    end = llm.MeanDisplacement((0.0, 0.0, 0.0))
    problem = s.problem(
        bcs=s.bcs[:2], interfaces=[s.interface, llm.Interface(s.tags, (4, end), law=llm.Tied())]
    )
    end.mean = pick(s, (0.0, 0.0, 0.0), (0.0, 0.0, None))
    problem.solve()


differ(
    "pressure and tags must be the same",
    lambda s: llm.free_surface_load(s.V, s.tags, 4, pick(s, 1.0, 2.0)),
)
differ("the loads must be", lambda s: s.nonlinear(loads=pick(s, (), s.pressure())))
differ(
    "increments, pressures and obstacles must be the same",
    lambda s: s.nonlinear().solve(pick(s, 1, 2)),
    lambda s: s.nonlinear(loads=s.pressure(pick(s, 1.0, 2.0))).solve(),
)
differ("numbers of Dirichlet conditions", lambda s: s.problem(bcs=pick(s, s.bcs, s.bcs[:2])))


def entries(size, part):
    """What is asked on a number of ranks: all on one; on two (in two parts) three quarters of that,
    on three the others, beside what only several get."""
    every = [*TABLE, *ONE_RANK]
    if size == 1:
        return every
    third = (1, 5, 9, 13)
    second = [k for k in range(1, 16) if k not in third]
    asked = {(2, 0): (0,), (2, 1): second, (3, 0): third}[size, part]
    return [e for k, e in enumerate(every) if k % 16 in asked] + (DIFFERENT if part == 0 else [])


def outcome(scene, entry):
    """What this rank got: class and message, and whether they are the right ones."""
    _, kind, words, call = entry
    try:
        call(scene)
    except kind as error:
        text = str(error)
        clean = "Traceback" not in text and " at 0x" not in text and len(text) < 800
        return [type(error).__name__, text, clean and bool(re.search(words, text, re.DOTALL))]
    except Exception as error:
        return [type(error).__name__, repr(error)[:500], False]
    return ["none", "no error", False]


if __name__ == "__main__":
    comm = MPI.COMM_WORLD
    scene, found = Scene(comm), {}
    for entry in entries(comm.size, int(sys.argv[1])):
        found[entry[0]] = comm.gather(outcome(scene, entry))
    if comm.rank == 0:
        print(json.dumps(found))
