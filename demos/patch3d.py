"""The 3D contact patch test of Rebel, Park and Felippa (2001), sections 2, 5 and 7.

A cylindrical punch stands on a block; their meshes do not match. Uniform pressure on all that is
free of the upper surfaces must give the same uniaxial stress in both bodies, to rounding.

    mpirun -n 2 python demos/patch3d.py [--refine N] [--frame paper|predicted|optimised] ...
"""

import argparse
import json
from pathlib import Path

import numpy as np
import paper_data as paper
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, post

FOUNDATION_TOP, PUNCH_BOTTOM, PUNCH_TOP, BOTTOM = 1, 2, 3, 4


# ## Geometry
# One dolfinx mesh with two volumes that share no node. Both have three layers of 8-node bricks.
def extrude(x, quads, z):
    """Bricks (in dolfinx's node order) from plane quads, anticlockwise, and levels z."""
    n = len(x)
    points = np.concatenate([np.column_stack([x, np.full(n, level)]) for level in z])
    layer = np.concatenate([quads[:, [0, 1, 3, 2]], quads[:, [0, 1, 3, 2]] + n], axis=1)
    return points, np.concatenate([layer + k * n for k in range(len(z) - 1)])


def cross_sections(n):
    """Nodes and quads of the foundation's top and of the punch, each split n-fold."""
    line = np.arange(-4 * n, 4 * n + 1) * (paper.SPACING / n)
    k = len(line)
    corner = np.array([i * k + j for i in range(k - 1) for j in range(k - 1)])
    top = np.array([[a, b] for a in line for b in line])
    quads = corner[:, None] + np.array([0, k, k + 1, 1])
    punch = paper.mirror(paper.PUNCH_NODES, paper.PUNCH_QUADS, paper.PUNCH_AXIS_EDGES)
    return (top, quads), paper.refine(*punch, n)


def scene(comm, refine=1, transform=lambda x: x):
    """Mesh and facet tags; ``transform`` moves the points (rotation, scaling, shift)."""
    foundation, punch = cross_sections(refine)
    z = np.linspace(0.0, 1.0, 3 * refine + 1)
    x0, cells0 = extrude(*foundation, z)
    x1, cells1 = extrude(*punch, z + 1.0)
    points, cells = np.concatenate([x0, x1]), np.concatenate([cells0, cells1 + len(x0)])
    if comm.rank > 0:
        points, cells = points[:0], cells[:0]
    domain = compat.create_mesh(comm, cells, points, "hexahedron")
    body = compat.cell_dofs(domain.geometry)[:, 0]
    second = np.asarray(domain.geometry.input_global_indices)[body] >= len(x0)
    domain.topology.create_connectivity(2, 3)
    to_cell = domain.topology.connectivity(2, 3)
    entities, values = [], []
    for tag, height, of_punch in (
        (FOUNDATION_TOP, 1.0, False),
        (PUNCH_BOTTOM, 1.0, True),
        (PUNCH_TOP, 2.0, True),
        (BOTTOM, 0.0, False),
    ):
        found = mesh.locate_entities_boundary(domain, 2, lambda p, h=height: np.isclose(p[2], h))
        facets = found[second[to_cell.array[to_cell.offsets[found]]] == of_punch]
        entities.append(facets)
        values.append(np.full(len(facets), tag, dtype=np.int32))
    entities, values = np.concatenate(entities), np.concatenate(values)
    order = np.argsort(entities)
    tags = mesh.meshtags(domain, 2, entities[order], values[order])
    domain.geometry.x[:] = transform(domain.geometry.x)
    return domain, tags


# ## The problem
# The user's forms, supports and loads come in as they are.
def stress(u, scale=1.0):
    """Hooke's law."""
    mu, lam = paper.E / (2 * (1 + paper.NU)), paper.E * paper.NU / (1 + paper.NU) / (1 - 2 * paper.NU)
    eps = ufl.sym(ufl.grad(u))
    return scale * (2 * mu * eps + lam * ufl.tr(eps) * ufl.Identity(3))


def supports(V):
    """Sliding on the bottom; no rigid motion in its plane."""
    bcs = []
    for k, where in (
        (2, lambda p: np.isclose(p[2], 0.0)),
        (0, lambda p: np.isclose(p[2], 0.0) & np.isclose(p[0], 0.0)),
        (1, lambda p: np.isclose(p[2], 0.0) & np.isclose(p[1], 0.0)),
    ):
        Vk, _ = V.sub(k).collapse()
        dofs = fem.locate_dofs_geometrical((V.sub(k), Vk), where)
        bcs.append(fem.dirichletbc(fem.Function(Vk), dofs, V.sub(k)))
    return bcs


def loads(V, tags):
    """Pressure on the punch's top and on what the punch leaves free of the foundation's."""
    p = paper.PRESSURE
    return [
        llm.free_surface_load(V, tags, PUNCH_TOP, p),
        llm.free_surface_load(V, tags, FOUNDATION_TOP, p, covered_by=(tags, PUNCH_BOTTOM)),
    ]


def contact_frame(kind, refine=1):
    """The frame of 6 x 7 nodes (Table 2), or None: predicted from the surfaces."""
    if kind == "predicted" or refine > 1 and kind == "optimised":
        return None
    quarter = paper.FRAME_OPTIMISED if kind == "paper" else paper.FRAME_PREDICTION
    x, cells = paper.frame_mesh(quarter)
    return llm.Frame(np.column_stack([x, np.ones(len(x))]), cells)


def problem(V, tags, kind="optimised", refine=1, sides=(FOUNDATION_TOP, PUNCH_BOTTOM), **options):
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    zero = fem.Constant(V.mesh, np.zeros(3))
    design = {"paper": None, "predicted": "weights", "optimised": "positions"}[kind]
    if refine > 1 and kind == "optimised":
        design = "weights"
    interface = llm.Interface(
        tags, sides, law=llm.Tied(), frame=contact_frame(kind, refine), design=design
    )
    return llm.ContactProblem(
        ufl.inner(stress(u), ufl.grad(w)) * ufl.dx,
        ufl.inner(zero, w) * ufl.dx,
        bcs=supports(V),
        interfaces=[interface],
        nodal_loads=loads(V, tags),
        **options,
    )
