"""How far both sides slide along each other in a load step; nodes that carry the frame by places.

These are no pairs of their own, and functions that fit the slip of the pairs about them say more
than bodies move where pairs count from different moments. So a node's way in an increment is from
the point of the moving side that it faced at the start to the one that it faces now, where these
are now. All of it is slip of a node that was in contact then; of one that has come into contact
since it is the part that pairs about it count of theirs. Nodes that come in from beyond the rim
faced nothing: they have the mean of these pairs' slip.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.finite.frame.location import INSIDE
from dolfinx_llm.finite.frame.sides import Sides
from dolfinx_llm.finite.frame_side import on_mover, shapes_on_frame, status_of_frame
from dolfinx_llm.finite.pairs.friction_law import in_plane
from dolfinx_llm.finite.pairs.normal_contact import NormalPlace
from dolfinx_llm.finite.pairs.slides import along_facets
from dolfinx_llm.finite.pairs.terms import ContactTerms, Held, MovingContact
from dolfinx_llm.interface.forces import per_area
from dolfinx_llm.laws.rows import OPEN, STICK


class Slid:
    """How far an interface has slid since a load step began.

    Args:
        contact: the interface.
    """

    def __init__(self, contact: MovingContact) -> None:
        self._contact = contact
        self._pairs: Any = None  # what keeps slip for the increments to come
        self._frame: csr_matrix | None = None

    def on(
        self, before: Any, t: ContactTerms, held: Held, status: Array | None
    ) -> tuple[Array, Array]:
        """(n, gdim) and (m, gdim) slip of pairs and of the frame's nodes with an increment more, of
        what has parted since the load step began from where it touched again [length].

        Args:
            before: how pairs stand at the start of the increment.
            t: at its end.
            held: then.
            status: (n,) of pairs at the start; None: not known.
        """
        since = (t.status == OPEN) | (False if status is None else status != OPEN)
        slip, now = (self._contact.slip(t.place, held, since, of) for of in (self._pairs, None))
        self._pairs = self._contact.written(t.place, slip)
        there, self._frame = _of_frame(self._contact, before, t, held, now, self._frame)
        return slip, there


def _of_frame(
    contact: MovingContact,
    before: Any,
    t: ContactTerms,
    held: Held,
    slip: Array,
    earlier: csr_matrix | None,
) -> tuple[Array, csr_matrix | None]:
    """Slip of the frame's nodes, 0 of ties and where open, and what keeps it; as of ``Slid.on``,
    for the slip (n, gdim) of the pairs in this increment alone."""
    sides, place, cells = contact.sides, t.place, contact.sides.mover.cells
    if sides.frame is None:
        return np.zeros((0, sides.gdim)), None
    x, y = sides.split(place.z)
    cells = cells[(before.pairs | place.pairs)[cells].all(axis=1)]
    if not isinstance(place, NormalPlace) or held.origin is None or not len(cells):
        return np.zeros_like(y), None
    active, normal = t.status != OPEN, sides.outward(place.z)
    shapes = diagonal(active) @ shapes_on_frame(sides, place.z, place.at)
    first = shapes_on_frame(sides, before.z, before.at)
    status, touched = status_of_frame(shapes, t.status), held.origin.gap == 0.0
    since = status_of_frame(first, touched) & (status != OPEN)
    faced, at = (on_mover(sides, then.z, cells) for then in (before, place))
    start, end = (np.einsum("mk,mki->mi", of.N, x[cells[of.facet]]) for of in (faced, at))
    way = in_plane(normal, end - start)
    part = _counted(sides, before, place, shapes, slip)
    part[since & (status != STICK)] = 1.0
    comes_in = ~faced.met | (faced.beyond > INSIDE) & ~(since & (at.beyond >= faced.beyond))
    mean = per_area(shapes.T @ (sides.nodal @ slip), shapes.sum(axis=0).A1)
    found = np.where(comes_in[:, None], in_plane(normal, -mean), part[:, None] * way)
    if earlier is not None:
        found += since[:, None] * in_plane(normal, earlier @ x)
    found[status == OPEN] = 0.0
    return found, along_facets(at, x, cells, normal, found)


def _counted(
    sides: Sides, before: NormalPlace, place: NormalPlace, shapes: csr_matrix, slip: Array
) -> Array:
    """(m,) part of their ways in an increment that the pairs about each node count as slip
    (n, gdim), by weights (n, m)."""
    (x, y), at = sides.split(place.z), before.at
    start = np.einsum("nk,nki->ni", at.N, y[sides.carrier.cells[at.facet]])
    way = np.where(at.met[:, None], in_plane(place.normal, x - start), 0.0)
    own = sides.nodal @ slip
    counted, all_of_it = (shapes.T @ np.einsum("ni,ni->n", a, way) for a in (own, way))
    return np.clip(counted / np.where(all_of_it > 0.0, all_of_it, np.inf), 0.0, 1.0)
