"""Contact pairs: a surface node and the point of the frame that it touches."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, identity, vstack
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh, splu

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.geometry.cells import bases
from dolfinx_llm.geometry.element import Element
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.loads import NodalLoads
from dolfinx_llm.geometry.overlap_flat import Plane
from dolfinx_llm.geometry.surface import Surface

BOUND = 1e-3  # of the singular values' ratio
DRAW = 1e-3  # of a frame node's mean support: what draws its motion to 0


def control_matrices(surface: Surface) -> tuple[csr_matrix, csr_matrix]:
    """E and E^-1 (n, n) of ``Element.bernstein``: values at a surface's nodes from control values,
    and these from values at nodes."""
    return control_of(surface.element, surface.cells, len(surface.x))


def control_of(element: Element, cells: Array, n: int) -> tuple[csr_matrix, csr_matrix]:
    """The same of n nodes in cells (f, k)."""
    E = element.bernstein
    inverse = np.round(16.0 * np.linalg.inv(E)) / 16.0  # they are multiples of a quarter
    return nodal_rows(cells, E, n), nodal_rows(cells, inverse, n)


def control_points(surface: Surface) -> Array:
    """(n, gdim) control values of where a surface's nodes are drawn: where its unknowns are in
    control values. Of straight facets they are the nodes' own [length]."""
    return np.asarray(control_matrices(surface)[1] @ surface.X)


def nodal_rows(cells: Array, table: Array, n: int) -> csr_matrix:
    """(n, n) matrix whose row of a node is that of its place in a cell (m, k), in a table (k, k)
    which says the same of it in each of its cells."""
    nodes, first = np.unique(cells, return_index=True)
    cell, place = np.divmod(first, cells.shape[1])
    index = np.repeat(nodes, cells.shape[1]), cells[cell].ravel()
    matrix = csr_matrix((table[place].ravel(), index), (n, n))
    matrix.eliminate_zeros()
    return matrix


@dataclass(frozen=True, eq=False)
class ContactPairs:
    """The pairs of one side; n of them, on a frame of m nodes."""

    surface: Surface  # the side's surface
    nodes: Array  # (n,) nodes of the surface that take part
    loads: NodalLoads  # what pressure on the area in contact exerts at them
    cell: Array  # (n,) frame cell of each node
    N: csr_matrix  # (n, m) N_J(xi_p), after design
    normal: Array  # (n, gdim) frame normal, out of this side; of a scalar field, whose
    # vectors have one component, (n, 1): 1 of side 0, -1 of side 1
    base: Array  # (n, c, gdim) local base vectors of the multipliers; (n, 1, 1) the same signs
    gap: Array  # (n, gdim) X_p - sum_J N_J Y_J [length]; (n, 1) zeros
    control: csr_matrix | None = None  # (n, n) E where rows, gaps and forces are those of control
    # values (``Element.bernstein``): nodal values from them; None: they are of the nodes

    @property
    def forces(self) -> Array:
        """(n,) energy-equivalent force of unit pressure, the tributary area [area]."""
        return self.loads.forces

    @property
    def x(self) -> Array:
        """(n, gdim) node positions [length]."""
        return self.surface.x[self.nodes]

    @property
    def X(self) -> Array:
        """(n, gdim) the same as drawn, where periodic sides lie apart [length]."""
        return self.surface.X[self.nodes]

    @property
    def places(self) -> Array:
        """(n, gdim) where the unknowns of the rows are: nodes as drawn, or control points."""
        return self.X if self.control is None else control_points(self.surface)[self.nodes]

    @property
    def met(self) -> Array:
        """(n, gdim) where the nodes meet the frame, or an obstacle, as drawn [length]."""
        return self.x - (self.gap if self.control is None else self.control @ self.gap)

    @cached_property
    def fit(self) -> Any:
        """Factorised NᵀN, by which motions of the nodes are fitted to those of the frame's; those
        of frame nodes that hardly any pair reaches are drawn to 0."""
        A = self.N.T @ self.N
        return splu((A + DRAW * A.diagonal().mean() * identity(A.shape[0])).tocsc())

    @cached_property
    def cells(self) -> Array:
        """(m, k) all nodes of the facets between nodes that take part, by place in ``nodes``."""
        place = np.full(len(self.surface.x), -1)
        place[self.nodes] = np.arange(len(self.nodes))
        cells = place[self.surface.cells]
        return cells[(cells >= 0).all(axis=1)]

    @property
    def facets(self) -> Array:
        """(m, c) corners of the same."""
        return self.cells[:, : self.surface.facets.shape[1]]

    @property
    def skin(self) -> Array:
        """(s, c) first-order facets between all nodes of the same."""
        parts = self.surface.element.parts
        return self.cells[:, parts].reshape(-1, parts.shape[1])

    def interpolation(self, x: Array) -> csr_matrix:
        """(k, n) values of the nodes at the point of the facets that is closest to each position;
        where several are as close, as above a fold, their mean.

        Args:
            x: (k, gdim) positions [length].
        """
        used, cells = np.unique(self.facets, return_inverse=True)
        at = Frame(self.x[used], cells.reshape(self.facets.shape)).locate(x)
        also, cell, xi = at.equal
        row = np.append(np.arange(len(x)), also)
        nodes = self.cells[np.append(at.cell, cell)]
        N = self.surface.element.shape(np.concatenate([at.xi, xi]))[0]
        N = N / np.bincount(row)[row][:, None]
        rows = np.repeat(row, nodes.shape[1])
        return csr_matrix((N.ravel(), (rows, nodes.ravel())), (len(x), len(self.nodes)))

    @property
    def dofs(self) -> Array:
        """(n,) global numbers of the nodes' blocks of dofs."""
        return self.surface.dofs[self.nodes]

    @property
    def owner(self) -> Array:
        """(n,) ranks that own the nodes."""
        return self.surface.owner[self.nodes]


def locate_pairs(
    sides: Sequence[Surface],
    loads: Sequence[NodalLoads],
    frame: Frame,
    reach: float,
    plane: Plane | None = None,
) -> list[ContactPairs]:
    """Pairs of both sides, in the Cartesian base, with the frame, which must cover them.

    Args:
        sides: their surfaces; the bases of side 1 change sign (paper, after (9)).
        loads: of the surfaces' nodes.
        frame: the frame, its normal out of side 0.
        reach: how far, in cells, a node may lie beyond the frame's outline.
        plane: contact plane, along whose normal nodes meet a flat frame; None: they meet the
            closest point of the frame.
    """
    nodes = [np.flatnonzero(load.touched) for load in loads]
    points = [_meeting(side, own, frame, plane) for side, own in zip(sides, nodes, strict=True)]
    at = frame.locate(np.concatenate(points))  # at once: of few points each search costs the same
    ends = np.cumsum([0, *map(len, nodes)])
    parts = [slice(*pair) for pair in pairwise(ends)]
    for side, own, part in zip(sides, nodes, parts, strict=True):
        _require_cover(side, own, at.outside[part], reach)
    if plane is None:
        normals = bases(frame.evaluate(at.cell, at.xi)[2])[:, -1]
    else:
        normals = np.broadcast_to(plane.normal, at.x.shape)
    found, every = [], frame.interpolation(at)
    for side, load, own, part, sign in zip(sides, loads, nodes, parts, (1.0, -1.0), strict=True):
        base = np.tile(sign * np.eye(frame.gdim), (len(own), 1, 1))
        N, cell = every[part], at.cell[part]
        gap = side.x[own] - N @ frame.x
        pairs = ContactPairs(side, own, load.of(own), cell, N, sign * normals[part], base, gap)
        found.append(pairs)
    return found


def _meeting(side: Surface, nodes: Array, frame: Frame, plane: Plane | None) -> Array:
    """(n, gdim) positions whose closest points of the frame some nodes of a side meet [length]."""
    if plane is None:
        return side.x[nodes]
    points = side.straightened(side.x)[nodes]
    off = plane.height(points) - plane.height(frame.x).mean()
    return points - np.outer(off, plane.normal)


def _require_cover(side: Surface, nodes: Array, outside: Array, reach: float) -> None:
    """Require that nodes lie by (n,) ``outside`` beyond the frame's outline, at most by a reach."""
    beyond = np.flatnonzero(outside > reach)
    if len(beyond):
        worst = beyond[outside[beyond].argmax()]
        raise ContactInputError(
            f"the frame does not cover the contact area: {len(beyond)} of {len(nodes)} nodes of "
            f"{side.name} in contact lie outside it, the farthest at "
            f"{checks.place(side.x[nodes[worst]])} by {outside[worst]:.3g} cells. Extend the frame "
            "over all facets that the contact area touches, or use frame=None for a predicted one"
        )


def with_weights(pairs: ContactPairs, N: csr_matrix, frame: Frame) -> ContactPairs:
    """The same pairs with other rows of L_b."""
    return replace(pairs, N=N, gap=pairs.x - N @ frame.x)


def rank_certificate(frame: Frame, N: Sequence[csr_matrix]) -> tuple[float, float]:
    """Smallest and largest singular value of the scalar L_b (both sides stacked), which must have
    full column rank ((33) needs it), and a ratio of them above ``BOUND``."""
    L = vstack(N, format="csr")
    m = L.shape[1]
    support = np.bincount(L.indices, np.abs(L.data), m)
    free = np.flatnonzero(support <= 1e-12)
    if L.shape[0] < m or len(free):
        weak = np.argsort(support)[:10]  # of those that are too many, the least supported
        at = f"; no surface node touches the cells of the frame nodes {free[:10].tolist()}"
        if not len(free):
            at = f"; least supported are the frame nodes {weak.tolist()}"
        raise ContactError(
            f"the frame is too fine: {m} nodes against {N[0].shape[0]} + {N[1].shape[0]} surface "
            f"nodes in contact{at}. L_b needs full column rank; take cells "
            "about as large as those of the coarser side, or frame=None"
        )
    if m <= 600:
        # The squares' rounding is far below the BOUND's square.
        values, vectors = np.linalg.eigh((L.T @ L).toarray())
        smallest, largest = np.sqrt(np.maximum(values[[0, -1]], 0.0))
        vector = vectors[:, 0]
    else:
        smallest, largest, vector = _extreme_singular_values(L)
    if not smallest > BOUND * largest:
        weak = np.argsort(-np.abs(vector))[:8]
        raise ContactError(
            f"the frame is too fine or badly placed: L_b has the singular values {smallest:.2e} to "
            f"{largest:.3g}, below the bound {BOUND:g} for their ratio. The surface nodes hardly "
            f"hold the frame nodes {weak.tolist()} at {frame.x[weak].round(5).tolist()}. Take "
            "cells about as large as those of the coarser side, or frame=None"
        )
    return float(smallest), float(largest)


def _extreme_singular_values(L: Any) -> tuple[float, float, Array]:
    """Estimates for a large sparse L by Lanczos on LᵀL, within about a per cent. LᵀL is like a mass
    matrix: its small end, too, is found without a factorisation."""
    A = LinearOperator((L.shape[1],) * 2, matvec=lambda x: L.T @ (L @ x), dtype=np.float64)
    start = np.random.default_rng(2001).standard_normal(L.shape[1])
    largest = abs(L.T @ L).sum(axis=1).max()  # a bound, where Lanczos fails
    try:
        largest = eigsh(A, k=1, which="LA", v0=start, tol=1e-2, return_eigenvectors=False)[0]
        low, vector = eigsh(A, k=1, which="SA", v0=start, tol=1e-2, ncv=40, maxiter=100)
    except ArpackError:  # no convergence: eigenvalues crowd at zero
        return 0.0, np.sqrt(largest), np.zeros(L.shape[1])
    return np.sqrt(max(low[0], 0.0)), np.sqrt(largest), vector[:, 0]
