"""Functions that users give, at the nodes of surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices

from dolfinx_llm.base import compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.spaces import order_of
from dolfinx_llm.geometry.surface import facet_nodes


def values_at_surfaces(function: Any, V: Any) -> Array:
    """(n,) values of a scalar Function at the nodes that this rank owns of V, a vector space of its
    mesh, where facets are on the surface of the bodies: the mean of those facets' cells, among
    which values may jump. 0 at all other nodes; collective.

    Raises:
        ContactInputError: a Function that is not scalar, or that has values at points of a
            quadrature rule.
    """
    if len(function.ufl_shape):
        raise ContactInputError(
            f"Function {function.name} has the shape {function.ufl_shape}: give a scalar one"
        )
    if compat.points_of(function.function_space) is not None:
        raise ContactInputError(
            f"Function {function.name} has values at points of a quadrature rule, none at nodes: "
            "give one of a Lagrange space, continuous or not"
        )
    mesh = V.mesh
    family = "DG" if compat.cell_kinds(mesh)[0] in ("triangle", "tetrahedron") else "DQ"
    by_cell = fem.Function(compat.function_space(mesh, family, order_of(V)))
    by_cell.interpolate(function)
    fdim = mesh.topology.dim - 1
    mesh.topology.create_connectivity(fdim, fdim + 1)
    mesh.topology.create_connectivity(fdim + 1, fdim)
    cells, nodes = facet_nodes(V, exterior_facet_indices(mesh.topology))
    own, theirs = (
        np.take_along_axis(compat.cell_dofs(space)[cells], nodes, axis=1)
        for space in (V, by_cell.function_space)
    )
    values = by_cell.x.array[theirs]
    sums = compat.ghosted_vector(V, 2)
    with sums.localForm() as local:
        at = local.array.reshape(-1, 2)
        np.add.at(at, own, np.stack([values, np.ones_like(values)], axis=-1))
    total, count = compat.summed(sums).reshape(-1, 2).T
    return total / np.maximum(count, 1.0)
