"""Function spaces and meshes that bodies may have."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import check

# Kinds of cells, and their nodes at first and second order.
CELLS = {"triangle": (3, 6), "quadrilateral": (4, 9), "tetrahedron": (4, 10), "hexahedron": (8, 27)}
SECOND_AT_MOST = (
    ": interfaces keep second order at most, which would be all that is left of a higher one, and "
    "corners of 8-node facets pull where a pressure acts"
)


def check_space(V: Any, highest: int = 1, scalar: bool = False) -> None:
    """Require, on all ranks, a vector space of Lagrange elements of first order, or up to the
    ``highest``, with one dof per direction, on a first-order mesh of triangles, quadrilaterals,
    tetrahedra or hexahedra; or a ``scalar`` space of such elements."""
    if isinstance(V, type) or not all(hasattr(V, k) for k in ("mesh", "dofmap", "element")):
        checks.refuse("V", V, "give a dolfinx function space")
    _check_mesh(V.mesh, highest)
    check(
        V.mesh.comm,
        is_mixed(V),
        "the function space is mixed, of several blocks: give that of the displacement, "
        "V.sub(i).collapse()[0]; problems of contact alone take the mixed one",
        ContactInputError,
    )
    layout, gdim, bs = V.dofmap.dof_layout, V.mesh.geometry.dim, V.dofmap.index_map_bs
    nodes = CELLS[compat.cell_kinds(V.mesh)[0]]
    degree = compat.geometry_degree(V.mesh)
    check(
        V.mesh.comm,
        degree > 1 and layout.num_dofs == nodes[0],
        f"the mesh has cells of order {degree} and the function space is of first order: give the "
        f"space that order too, or the mesh the first (gmsh.model.mesh.setOrder(1))",
        ContactInputError,
    )
    orders = " or second" if highest > 1 else ""
    check(
        V.mesh.comm,
        not _has_nodes(V, nodes[degree - 1 : highest], (gdim, 1) if scalar else (gdim,)),
        f"the function space must be a vector space of first{orders} order (Lagrange elements with "
        f"{' or '.join(map(str, nodes[:highest]))} nodes per cell, {gdim} components"
        f"{', or 1 of a temperature' * scalar}); this one "
        f"has {layout.num_dofs} nodes per cell and {bs} component(s). Use "
        f"functionspace(mesh, ('Lagrange', 1, ({gdim},))){', or 2 for 1' * (highest > 1)}"
        f"{SECOND_AT_MOST * (highest > 1 and layout.num_dofs > nodes[0])}",
        ContactInputError,
    )


def _has_nodes(V: Any, nodes: tuple[int, ...], components: tuple[int, ...]) -> bool:
    """Whether a space is of Lagrange elements with such numbers of nodes and components."""
    layout = V.dofmap.dof_layout
    fits = V.dofmap.index_map_bs in components and layout.num_dofs in nodes
    return fits and len(layout.entity_dofs(0, 0)) == 1 and compat.has_nodes(V)


def is_mixed(V: Any) -> bool:
    """Whether a function space has blocks that are no components of one vector."""
    return V.num_sub_spaces > 1 and V.dofmap.index_map_bs == 1


def displacement_block(W: Any) -> tuple[Any, Array]:
    """Of a mixed space the block that is a displacement, up to second order, as a space of its own,
    and (n,) which dof of W each of its local ones is.

    Raises:
        ContactInputError: none of the blocks is one, or several are.
    """
    _check_mesh(W.mesh, 2)
    degree = compat.geometry_degree(W.mesh)
    nodes = CELLS[compat.cell_kinds(W.mesh)[0]][degree - 1 :]
    gdim, count = W.mesh.geometry.dim, W.num_sub_spaces
    # Only these: collapse() of a discontinuous scalar crashes on a rank without cells in 0.5.2.
    vectors = [V for V in map(W.sub, range(count)) if V.num_sub_spaces == gdim]
    found = [
        (V, dofs) for V, dofs in (V.collapse() for V in vectors) if _has_nodes(V, nodes, (gdim,))
    ]
    check(
        W.mesh.comm,
        len(found) != 1,
        f"{len(found)} of the {count} blocks of the mixed space can be the displacement: one "
        f"must be a vector space of Lagrange elements with {' or '.join(map(str, nodes))} nodes "
        "per cell, and no other",
        ContactInputError,
    )
    V, dofs = found[0]
    return V, np.ravel(np.asarray(dofs, dtype=np.int64))  # or a list of such arrays


def is_scalar(V: Any) -> bool:
    """Whether a function space that ``check_space`` has passed is that of a temperature or the
    like."""
    return bool(V.dofmap.index_map_bs == 1)


def order_of(V: Any) -> int:
    """Order of a function space that ``check_space`` has passed."""
    nodes = CELLS[compat.cell_kinds(V.mesh)[0]]
    return 1 + nodes.index(V.dofmap.dof_layout.num_dofs)


def is_function(value: Any) -> bool:
    """Whether this is a dolfinx Function."""
    return isinstance(value, fem.Function)


def _check_mesh(mesh: Any, highest: int) -> None:
    """Require bodies that fill the space, of cells of one kind up to an order."""
    kinds = compat.cell_kinds(mesh)
    degree = compat.geometry_degree(mesh) if len(kinds) == 1 else 1
    tdim, gdim = mesh.topology.dim, mesh.geometry.dim
    text = ""
    if len(kinds) != 1 or kinds[0] not in CELLS:
        text = f"the mesh has cells of the kind(s) {', '.join(kinds)}: made for {', '.join(CELLS)}"
    elif tdim != gdim:
        text = (
            f"the mesh is a surface or curve of dimension {tdim} in {gdim}D: bodies must fill the "
            "space (model_to_mesh(..., gdim=2) for bodies in the plane)"
        )
    elif degree > highest:
        text = (
            f"the mesh has cells of order {degree}: made for first-order meshes, whose facets are "
            "straight (gmsh.model.mesh.setOrder(1))"
        )
    elif (own := _nodes_of(mesh)) not in (0, nodes := CELLS[kinds[0]][degree - 1]):
        text = (
            f"the mesh has cells of order {degree} with {own} of {nodes} nodes each, as submeshes "
            "that old versions of dolfinx make of second-order meshes: make one mesh per body"
        )
    elif mesh.geometry.x.dtype != np.float64:
        text = f"the mesh has coordinates of type {mesh.geometry.x.dtype}: made for float64"
    check(mesh.comm, bool(text), text, ContactInputError)


def _nodes_of(mesh: Any) -> int:
    """Nodes that the geometry of this rank's cells has; 0 without cells."""
    dofs, topology = compat.cell_dofs(mesh.geometry), mesh.topology
    index_map = topology.index_map(topology.dim)
    count = index_map.size_local + index_map.num_ghosts
    return dofs.size // count if count else 0
