"""Where supports prescribe the tangential motion of both sides of an interface, as on a plane of
symmetry.

Rows there tell nothing but how supports share friction, if both sides move alike. Designed rows do
not even say that: they reach to frame nodes beyond, and would hold these. So they are left out for
as long as what is prescribed does not slip. With friction one for each frame node next to them
holds it, ``pins``, as the mirrored half of the bodies would (``contact/equations/at_supports``):
on planes that both bodies end on, and that the surface meets squarely. Elsewhere supports of one
body would bear what the other asks for, and rows there stay. Without friction one of each side
stays at frame nodes that hardly any other rows hold: by corrections alone they would drift. Where
it slips all but one for each frame node are left out. So along curved surfaces of second order,
where frame nodes on the plane would else be free along the surface, and thus across it where
normals differ: rows at supports are not designed there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, nearest
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.laws.frictionless import FreeSlip
from dolfinx_llm.operators.numbering import BodyDofs, Place
from dolfinx_llm.operators.prescribed import NEARLY_FIXED, free_parts

ALL = 0.9  # part of what surrounds a place that counts as all of it: rims may lie off each other
MOSTLY = 0.5  # row's part in a frame node from which on its node is next to it
COINCIDES = 0.999  # the same of a node that is the frame node's own
HELD_BY_OTHERS = 0.1  # sum of N² of pairs that supports leave free, which hold a frame node
SQUARELY = 2e-3  # part of a row along free dofs: planes of coarse round surfaces lean by 1.3e-3
SAME_PLANE = 1e-6  # of a surface's extent: so far apart supports of both sides may lie, across
HELD_STILL = 1e-9  # slip over the largest prescribed motion that is none


def along_supports(pairs: Sequence[ContactPairs], free: Array, held: Array) -> list[ContactPairs]:
    """The pairs of both sides, whose rows by which supports hold frames act along prescribed dofs
    alone, if they nearly do.

    Args:
        pairs: of an interface.
        free: (n c, gdim) base vectors of its rows at free dofs.
        held: (n c,) which rows hold frames; where none does the pairs stay as they are.
    """
    if not held.any():
        return list(pairs)
    part = np.where((held & _squarely(free))[:, None], free, 0.0)
    each = np.split(part.reshape(-1, *pairs[0].base.shape[1:]), [len(pairs[0].nodes)])
    return [replace(p, base=p.base - own) for p, own in zip(pairs, each, strict=True)]


def _squarely(free: Array) -> Array:
    """Whether base vectors (..., gdim) at free dofs are next to none."""
    return np.asarray(np.linalg.norm(free, axis=-1) <= SQUARELY)


def prescribed_on_both_sides(
    geometry: InterfaceGeometry,
    across: Sequence[csr_matrix],
    fixed: Sequence[Array],
    soft: Array,
) -> tuple[Array, Array]:
    """(n, c) rows of an interface whose motion supports prescribe at their own nodes, and at the
    place on the other side as well; and which of them do so across a plane common to both.

    Args:
        geometry: two sides and a frame.
        across: per side (n_i, n_j) the other side's nodes at its nodes.
        fixed: per side (n_i, gdim) 1.0: prescribed dofs.
        soft: (n c,) rows that supports prescribe at their own nodes.
    """
    parts, alike = list[Array](), list[Array]()
    for k, (pairs, N) in enumerate(zip(geometry.pairs, across, strict=True)):
        (n, c, gdim), other, known = pairs.base.shape, geometry.pairs[1 - k], fixed[1 - k]
        part = N @ known
        free = pairs.base * (part < ALL)[:, None]
        parts.append(free_parts(free.reshape(-1, gdim), c).reshape(n, c) < NEARLY_FIXED)
        away = np.einsum("nci,ni->nc", pairs.base, N @ (known * other.x) - part * pairs.x)
        in_plane = np.abs(away) <= SAME_PLANE * other.surface.diameter
        alike.append(in_plane & _squarely(pairs.base * (1.0 - fixed[k])[:, None]))
    found = np.concatenate(parts)
    found &= soft.reshape(found.shape)
    # Where all motion along the surface is prescribed no row tells more than another.
    return found, found & (np.concatenate(alike) | found.all(axis=0))


def held_on_both_sides(
    geometries: Sequence[InterfaceGeometry],
    places: Sequence[Place],
    dofs: BodyDofs,
    side_dofs: Sequence[Array],
    soft: Array,
) -> tuple[list[BothSides], Array]:
    """Of all interfaces that have such rows; and (n,) which rows of laws by which sides part or
    slip supports prescribe on both sides.

    Args:
        geometries, places: of the interfaces.
        dofs, side_dofs: of the bodies, and per side (n, gdim).
        soft: (n,) rows that supports prescribe at their own nodes.
    """
    out, rows = list[BothSides](), np.zeros(len(soft), dtype=bool)
    if not soft.any():
        return out, rows
    fixed = [dofs.values(of, dofs.fixed.astype(float)) for of in side_dofs]
    for geometry, place in zip(geometries, places, strict=True):
        own = soft[place.rows]
        if geometry.interface.law.ties or len(geometry.pairs) < 2 or not own.any():
            continue
        first, second = geometry.pairs
        across = second.interpolation(first.x), first.interpolation(second.x)
        held, alike = prescribed_on_both_sides(geometry, across, fixed[place.sides], own)
        if geometry.interface.law.shares and not geometry.bent and geometry.site.carrier is None:
            held = alike
        rows[place.rows] = held.ravel()
        if held[:, :-1].any():
            out.append(BothSides.of(geometry, place, across, held, own.reshape(held.shape)))
    return out, rows


@dataclass(frozen=True, eq=False)
class BothSides:
    """Of two sides, one after the other."""

    sides: range  # among all sides
    rows: slice  # among all rows
    base: tuple[Array, Array]  # (n_i, c, gdim)
    across: tuple[csr_matrix, csr_matrix]  # (n_i, n_j) the other side's nodes at a side's nodes
    held: Array  # (n c,) tangential rows that supports prescribe on both sides
    spare: Array  # (n c,) those of nodes that are not the one next to a frame node
    lone: Array  # (n c,) those of nodes next to frame nodes that hardly any other rows hold
    pins: Array  # (n c,) with friction, of each frame node next to them the one next to it, or two

    @classmethod
    def of(
        cls,
        geometry: InterfaceGeometry,
        place: Place,
        across: tuple[csr_matrix, csr_matrix],
        held: Array,
        soft: Array,
    ) -> BothSides:
        """Of an interface of a law by which sides slip.

        Args:
            geometry: two sides and a frame.
            place: among all interfaces.
            across: per side (n_i, n_j) the other side's nodes at its nodes.
            held: (n, c) of ``prescribed_on_both_sides``.
            soft: (n, c) rows that supports prescribe at their own nodes.
        """
        own, other = geometry.pairs
        held, soft = np.pad(held[:, :-1], ((0, 0), (0, 1))), soft[:, :-1]
        at = np.split(held.any(axis=1), [len(own.nodes)])
        law, carried = geometry.interface.law, geometry.site.carrier is not None
        # With friction rows of others than its own nodes would share that among supports.
        rubs = geometry.bent and not (carried or isinstance(law, FreeSlip))
        least = COINCIDES if rubs else MOSTLY
        alone = np.concatenate([_next_to_nodes(p.N, a, least) for p, a in zip((own, other), at)])
        spare = held & ~alone[:, None]
        if carried:  # pairs of the other side slip each by itself
            carries = geometry.carries[:, None]
            spare, held = spare & carries, np.where(carries, spare, held)
        elif geometry.bent:
            held = spare
        lone, pins = np.zeros((2, *held.shape), dtype=bool)
        if law.slips and not (law.gives or carried):
            N = vstack(geometry.law_shapes).tocsr()
            if law.shares:  # along curved surfaces the rows next to frame nodes stay
                part = N.multiply(N > MOSTLY).T.tocsr()  # alike on both sides: one of each
                near = [nearest(part @ diagonal(a)).getnnz(axis=0) > 0 for a in held.T]
                pins = np.stack(near, axis=1) & (not geometry.bent)
            else:
                others = np.asarray(N[~soft.all(axis=1)].power(2).sum(axis=0))
                weak = (others > HELD_STILL**2) & (others < HELD_BY_OTHERS)  # else it stays at rest
                next_to = N.multiply(weak).max(axis=1).toarray()[:, 0] > MOSTLY
                lone = held & (alone & next_to)[:, None]
        sides = range(place.sides.start, place.sides.stop)
        return cls(
            sides,
            place.rows,
            (own.base, other.base),
            across,
            held.ravel(),
            spare.ravel(),
            lone.ravel(),
            pins.ravel(),
        )

    def rest(self, motions: Sequence[Array]) -> tuple[Array, Array]:
        """(n c,) such rows along which neither side slips, and those that are spare, but for those
        by which frame nodes without friction are held that nothing else holds; and the pins.

        Args:
            motions: per side (n_i, gdim) prescribed displacements, 0 where none is [length].
        """
        slips = [
            np.einsum("nci,ni->nc", a, u - N @ v)
            for a, N, u, v in zip(self.base, self.across, motions, motions[::-1], strict=True)
        ]
        most = HELD_STILL * max(np.abs(u).max(initial=0.0) for u in motions)
        rests = self.held & (np.abs(np.concatenate(slips).ravel()) <= most)
        return self.spare | (rests & ~self.lone), rests & self.pins


def _next_to_nodes(N: csr_matrix, among: Array, least: float) -> Array:
    """(n,) those of some nodes, with rows N (n, m), that have the largest part in a frame node, and
    more than ``least``."""
    found, rows = np.zeros(len(among), dtype=bool), np.flatnonzero(among)
    if len(rows):
        part = N[rows].tocsc()
        largest = np.asarray(part.max(axis=0).todense()).ravel()
        found[rows[np.asarray(part.argmax(axis=0)).ravel()[largest > least]]] = True
    return found
