"""Quarters of bowls, between two planes of symmetry, on blocks."""

import numpy as np
import scenes
from dolfinx import fem
from mpi4py import MPI

from dolfinx_llm import compat

FLAT = [(k, scenes.on(k, 0.0)) for k in range(2)]
HELD = FLAT + [(k, scenes.on(2, 0.0)) for k in range(3)]  # and the block's bottom


def bowl_on_block(block, bowl):
    """Space, tags and the bowl's cells, of sections of both."""
    domain, tags = scenes.stacked(MPI.COMM_SELF, (block, bowl), (0.0, 1.0, 2.0))
    x, cells = domain.geometry.x, compat.cell_dofs(domain.geometry)
    above = np.flatnonzero(x[cells].mean(axis=1)[:, 2] > 1.0).astype(np.int32)
    nodes = np.unique(cells[above])
    x[nodes, 2] += 0.25 * (x[nodes, 0] ** 2 + x[nodes, 1] ** 2) * (2.0 - x[nodes, 2])
    return compat.function_space(domain, shape=(3,)), tags, above


def moved_down(block, bowl, down, sides=(2, 3), **choices):
    """The problem of such a bowl that supports move down as a whole."""
    V, tags, above = bowl_on_block(block, bowl)
    whole = fem.Function(V)
    whole.interpolate(lambda x: np.stack([0 * x[0], 0 * x[0], 0 * x[0] - down]))
    V.mesh.topology.create_connectivity(3, 3)  # from 0.9 on dolfinx asks for it
    bcs = scenes.hold(V, HELD)
    bcs.append(fem.dirichletbc(whole, fem.locate_dofs_topological(V, 3, above)))
    return scenes.block_problem(V, tags, sides, bcs=bcs, loads=[], **choices)
