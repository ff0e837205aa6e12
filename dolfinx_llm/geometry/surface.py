"""The contact surface of a body: nodes, dofs and facets, the same on every rank.

The surface is gathered to all ranks in an order that does not depend on their number: nodes sorted
by position, ties by the mesh's input numbering; facets by their nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import check, collective, gather_rows
from dolfinx_llm.geometry.cells import cell_sizes, vector_areas
from dolfinx_llm.geometry.element import Element, element_of
from dolfinx_llm.geometry.spaces import order_of
from dolfinx_llm.geometry.thickness import check_along, thickness_at


@dataclass(frozen=True, eq=False)
class Surface:
    """Tagged surface of one body."""

    x: Array  # (n, gdim) node positions now [length]
    facets: Array  # (m, c) corners of each facet; vector areas point out of the body
    dofs: Array  # (n,) global number of each node's block of dofs in its function space
    owner: Array  # (n,) rank that owns the node
    name: str  # for messages: "tag 3"
    drawn: Array | None = None  # (n, gdim) node positions as drawn; None: x [length]
    elements: Array | None = None  # (m, k) all nodes of each facet, corners first, see
    # ``Element``; None: there are no others
    origin: Array | float = 0.0  # (gdim,) from which positions count, see ``about`` [length]
    depth: Any = None  # thickness of bodies in the plane, as it was given: see ``thickness``

    @property
    def cells(self) -> Array:
        """(m, k) all nodes of each facet."""
        return self.facets if self.elements is None else self.elements

    @cached_property
    def skin(self) -> Array:
        """(s, c) first-order facets between all nodes."""
        parts = self.element.parts
        return self.cells[:, parts].reshape(-1, parts.shape[1])

    @cached_property
    def facet_size(self) -> float:
        """Of the largest facet, see ``cell_sizes`` [length]."""
        return float(cell_sizes(self.x, self.facets).max())

    @property
    def element(self) -> Element:
        """Shape functions of the facets."""
        return element_of(self.x.shape[1] - 1, self.cells.shape[1])

    @property
    def X(self) -> Array:
        """(n, gdim) node positions as drawn [length]."""
        return self.x if self.drawn is None else self.drawn

    @cached_property
    def thickness(self) -> Array | None:
        """(n,) at the nodes where they are, in between as shape functions say [length]; None: 1."""
        return self.thickness_at(self.x)

    def thickness_at(self, x: Array) -> Array | None:
        """The same with the nodes at x (n, gdim)."""
        return thickness_at(self.depth, x + self.origin)

    def with_depth(self, given: Any, name: str) -> Surface:
        """The same with a thickness; ``name`` of what it belongs to is for messages.

        Raises:
            ContactInputError: as ``thickness_at`` and ``check_along`` do.
        """
        found, what = replace(self, depth=given), f"{name}: the thickness of {self.name}"
        check_along(what, found.thickness, self.x, self.facets)
        return found

    def part(self, facets: Array) -> Surface:
        """Some of the facets (numbers), and their nodes, in the same order; of all the same."""
        if np.array_equal(facets, np.arange(len(self.cells))):
            return self
        chosen = self.cells[facets]
        nodes, cells = np.unique(chosen, return_inverse=True)
        cells = cells.reshape(chosen.shape)  # of no facets as well
        return replace(
            self,
            x=self.x[nodes],
            facets=cells[:, : self.facets.shape[1]],
            elements=None if self.elements is None else cells,
            dofs=self.dofs[nodes],
            owner=self.owner[nodes],
            drawn=None if self.drawn is None else self.drawn[nodes],
        )

    def of_corners(self) -> Surface:
        """The same with the corners alone, between which facets are straight."""
        if self.elements is None:
            return self
        nodes, facets = np.unique(self.facets, return_inverse=True)
        own = {name: getattr(self, name)[nodes] for name in ("x", "dofs", "owner")}
        facets = facets.reshape(self.facets.shape)
        return replace(self, facets=facets, elements=None, drawn=None, **own)

    def moved(self, u: Array) -> Surface:
        """The surface at x = X + u, u (n, gdim) since the drawing; nothing is gathered anew."""
        return replace(self, x=self.X + u, drawn=self.X)

    def about(self, centre: Array) -> Surface:
        """The surface as drawn with positions that count from a centre (gdim,) near it, by which
        they are rounded less than from far away."""
        return replace(self, x=self.x - centre, origin=self.origin + centre)

    def straightened(self, x: Array) -> Array:
        """Positions x (n, ...) of its nodes, those in the middle of bent edges moved onto the
        straight line between the ends [length]."""
        c = self.facets.shape[1]
        if self.elements is None:
            return x
        x = x.copy()
        x[self.elements[:, c:]] = self.element.between(x[self.facets])[:, c:]
        return x

    @cached_property
    def normal(self) -> Array:
        """(gdim,) sum of the outward vector areas [area]."""
        return vector_areas(self.x, self.facets).sum(axis=0)

    @cached_property
    def diameter(self) -> float:
        """Diagonal of the bounding box [length]."""
        return float(np.linalg.norm(np.ptp(self.x, axis=0)))


# Kinds of cells: numbers of vertices, edges and facets.
ENTITIES = {
    "triangle": (3, 3, 3),
    "quadrilateral": (4, 4, 4),
    "tetrahedron": (4, 6, 4),
    "hexahedron": (8, 12, 6),
}


def check_facet_tags(name: str, tags: Any) -> None:
    """Require dolfinx mesh tags."""
    if isinstance(tags, type) or not all(hasattr(tags, k) for k in ("dim", "indices", "values")):
        checks.refuse(name, tags, "give dolfinx mesh tags of facets (dolfinx.mesh.meshtags)")


def extract_surface(V: Any, facet_tags: Any, tag: int) -> Surface:
    """Gather the facets with a tag, their nodes and dofs, on all ranks.

    Raises:
        ContactInputError: no facet has the tag, or tagged facets lie inside the mesh.
    """
    mesh = V.mesh
    comm, topology = mesh.comm, mesh.topology
    fdim = topology.dim - 1
    with collective(comm):
        check_facet_tags("facet tags", facet_tags)
        checks.integer("facet tag", tag)
    check(
        comm,
        facet_tags.dim != fdim,
        f"facet tags of dimension {facet_tags.dim} do not mark facets, which have dimension {fdim}",
        ContactInputError,
    )
    check(
        comm,
        not compat.tags_belong_to(facet_tags, mesh),
        "the facet tags belong to another mesh than the function space",
        ContactInputError,
    )
    topology.create_connectivity(fdim, fdim + 1)
    topology.create_connectivity(fdim + 1, fdim)
    with collective(comm):
        rows = _local_facets(V, facet_tags.indices[facet_tags.values == tag])
    dofs, owners, source, inside, points, centres = (gather_rows(comm, r) for r in rows)
    if not len(dofs):
        present = np.unique(gather_rows(comm, np.unique(facet_tags.values)))
        raise ContactInputError(
            f"no facet has tag {tag}; the facet tags given have the values {present[:20].tolist()}"
        )
    # A facet can be known to several ranks: keep one of each. Where they know it by different
    # cells it lies inside the mesh, on a boundary between ranks.
    _, first, same = np.unique(
        np.sort(dofs, axis=1), axis=0, return_index=True, return_inverse=True
    )
    same = same.ravel()
    apart = np.abs(centres - centres[first][same]).max(axis=1)
    inside |= apart > 1e-6 * np.ptp(points, axis=1).max(axis=1)
    if inside.any():
        raise ContactInputError(
            f"tag {tag}: {len(np.unique(same[inside]))} tagged facets lie inside the mesh. The two "
            "sides of an interface need nodes of their own: mesh the bodies apart (in gmsh: do not "
            "fragment them, or open the surface by the Crack plugin), then tag each body's own "
            "boundary, or let llm.find_interfaces find it"
        )
    dofs, owners, source, points, centres = (
        a[first] for a in (dofs, owners, source, points, centres)
    )
    gdim = points.shape[2]
    element = element_of(gdim - 1, dofs.shape[1])
    c = element.corners
    _, first, cells = np.unique(dofs, return_index=True, return_inverse=True)
    x, source = points.reshape(-1, gdim)[first], source.ravel()[first]
    order = np.lexsort((source, *x.T[::-1]))
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    cells = rank[cells.reshape(dofs.shape)]
    x = x[order]
    outward = x[cells[:, :c]].mean(axis=1) - centres
    turned = np.einsum("fi,fi->f", vector_areas(x, cells[:, :c]), outward) < 0.0
    corner = np.where(turned[:, None], np.arange(c)[::-1], np.arange(c))
    cells = element.permuted(cells, corner)
    if c > 2:  # begin with the smallest node; a segment has no cycle to turn
        corner = (cells[:, :c].argmin(axis=1)[:, None] + np.arange(c)) % c
        cells = element.permuted(cells, corner)
    cells = cells[np.lexsort(cells[:, :c].T[::-1])]
    return Surface(
        x, cells[:, :c], dofs.ravel()[first][order], owners.ravel()[first][order], f"tag {tag}",
        elements=cells if element.order > 1 else None,
    )  # fmt: skip


def facet_nodes(V: Any, facets: Array) -> tuple[Array, Array]:
    """(m,) a cell of each local facet (m,), and (m, k) which of that cell's nodes are the facet's,
    as of ``Element``; the mesh has the connectivities of facets and cells."""
    topology, layout = V.mesh.topology, V.dofmap.dof_layout
    tdim, kind = topology.dim, compat.cell_kinds(V.mesh)[0]
    to_cell = topology.connectivity(tdim - 1, tdim)
    to_facet = topology.connectivity(tdim, tdim - 1)
    n_vertices, n_edges, n_facets = ENTITIES[kind]
    vertices = {layout.entity_dofs(0, i)[0] for i in range(n_vertices)}
    edges = {}
    if order_of(V) == 2:
        for i in range(n_edges):
            own = vertices.intersection(layout.entity_closure_dofs(1, i))
            edges[frozenset(own)] = layout.entity_dofs(1, i)[0]
    table = []
    for i in range(n_facets):
        nodes = [n for n in layout.entity_closure_dofs(tdim - 1, i) if n in vertices]
        if len(nodes) == 4:
            nodes = [nodes[j] for j in (0, 1, 3, 2)]  # dolfinx counts by rows; make it a cycle
        if edges:
            c = len(nodes)
            ends = [(nodes[j], nodes[(j + 1) % c]) for j in range(c if c > 2 else 1)]
            centre = list(layout.entity_dofs(2, i)) if tdim == 3 else []
            nodes = nodes + [edges[frozenset(pair)] for pair in ends] + centre
        table.append(nodes)
    cells = to_cell.array[to_cell.offsets[facets]]
    cell_facets = to_facet.array.reshape(-1, n_facets)[cells]
    return cells, np.array(table)[(cell_facets == facets[:, None]).argmax(axis=1)]


def _local_facets(V: Any, facets: Array) -> tuple[Array, ...]:
    """This rank's facets: global dofs, owners, input numbers, whether inside, points, centres."""
    mesh, gdim = V.mesh, V.mesh.geometry.dim
    to_cell = mesh.topology.connectivity(mesh.topology.dim - 1, mesh.topology.dim)
    inside = (to_cell.offsets[facets + 1] - to_cell.offsets[facets]) > 1
    cells, nodes = facet_nodes(V, facets)
    element = element_of(gdim - 1, nodes.shape[1])
    rows = np.arange(len(facets))[:, None]
    dofs = compat.cell_dofs(V)[cells]
    geometry = compat.cell_dofs(mesh.geometry)[cells]
    index_map = V.dofmap.index_map
    local = dofs[rows, nodes].astype(np.int32)
    dofs_global = index_map.local_to_global(local.ravel()).reshape(local.shape)
    points = mesh.geometry.x[:, :gdim]
    n_owned = index_map.size_local
    owner = np.full(local.shape, mesh.comm.rank, dtype=np.int64)
    ghost = local >= n_owned
    owner[ghost] = np.asarray(index_map.owners)[local[ghost] - n_owned]
    corners = geometry[rows, nodes[:, : element.corners]]
    source = np.asarray(mesh.geometry.input_global_indices)[corners]
    x = points[corners]
    if element.order > 1:  # an edge's node is told from others at its place by its ends
        source = np.where(element.linear > 0.0, source[:, None], -1).max(axis=2)
        straight = compat.geometry_degree(mesh) == 1
        x = element.between(x) if straight else points[geometry[rows, nodes]]
    return dofs_global, owner, source, inside, x, points[geometry].mean(axis=1)


def check_sides(side0: Surface, side1: Surface, same_mesh: bool) -> None:
    """Require two sides with nodes of their own."""
    shared = np.intersect1d(side0.dofs, side1.dofs if same_mesh else [])
    if len(shared):
        at = side0.x[np.isin(side0.dofs, shared)][:3].tolist()
        raise ContactError(
            f"the surfaces {side0.name} and {side1.name} share {len(shared)} nodes, e.g. at {at}: "
            "the bodies must have nodes of their own on the contact surface, and each side a tag "
            "(in gmsh: do not fragment them; a surface that the Crack plugin has opened has one "
            "tag for both sides, which llm.find_interfaces tells apart)"
        )
