"""An interface where its bodies have moved to: pairs found again, or all rebuilt."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.base.timing import Clock
from dolfinx_llm.interface.build import assembled, build, build_against, build_piece
from dolfinx_llm.interface.geometry import InterfaceGeometry


@dataclass(frozen=True, eq=False)
class Transfer:
    """How what an interface remembers goes from one geometry to the next."""

    frame: csr_matrix  # (m_new, m_old) values at the frame's nodes
    pairs: tuple[Array, ...]  # per side (n_new,) place among the old pairs, or -1
    sizes: tuple[int, ...]  # pairs per side before
    directions: tuple[Array, Array]  # (k, q, gdim) of jumps, before and now

    @property
    def old_pairs(self) -> Array:
        """(n_new,) place among the old pairs of all sides, or -1."""
        first = np.cumsum((0, *self.sizes[:-1]))
        moved = [np.where(at >= 0, at + k, -1) for at, k in zip(self.pairs, first, strict=True)]
        return np.concatenate(moved)

    @property
    def nodes(self) -> csr_matrix:
        """(k_new, k_old) values at the nodes of the law; rows of new ones are empty."""
        if self.frame.shape[1]:
            return self.frame
        new = np.flatnonzero(self.old_pairs >= 0)
        shape = (len(self.old_pairs), sum(self.sizes))
        return csr_matrix((np.ones(len(new)), (new, self.old_pairs[new])), shape)

    def turned(self, jumps: Array) -> Array:
        """(k_new, q) jumps along the directions of now, from (k_old, q) along the old ones."""
        before, now = self.directions
        vectors = np.einsum("kq,kqi->ki", jumps, before)
        return np.einsum("ki,kqi->kq", self.nodes @ vectors, now)


def relocated(
    geometry: InterfaceGeometry, motions: Sequence[Array], v: Array | None = None
) -> InterfaceGeometry:
    """The same facets, frame cells and nodes, where bodies and frame are now. Shape functions,
    normals, gaps, forces and the design are made anew; all sizes stay.

    Args:
        geometry: the interface before.
        motions: per side (n, gdim) displacement of the tagged surface since the drawing [length].
        v: (m, gdim) motion of the frame's nodes since ``geometry`` [length]; None without a frame.
    """
    site, clock, notes = geometry.site.moved(motions), Clock(), list[str]()
    if geometry.frame is None:
        return build_against(site, notes, clock, geometry.pairs[0].nodes)
    if v is None:
        raise ContactInputError("v=None: give the motion (m, gdim) of the frame's nodes")
    ends = np.cumsum([len(part.frame.x) for part in geometry.parts])

    def found() -> tuple[Any, ...]:
        parts = []
        for part, own in zip(geometry.parts, np.split(v, ends[:-1]), strict=True):
            last = replace(part, frame=part.frame.moved(own))
            parts.append(build_piece(site, part.piece.moved(site.whole), notes, clock, last=last))
        return parts, notes, clock

    parts, notes, clock = chosen(site.comm, found)
    rims = [np.zeros(len(side.x), dtype=bool) for side in site.whole]
    for rim, side, own, pairs in zip(rims, site.whole, geometry.rims, geometry.pairs, strict=True):
        rim[np.isin(side.dofs, pairs.dofs[own])] = True
    return assembled(site, parts, rims, notes, clock)


def rebuilt(
    geometry: InterfaceGeometry, motions: Sequence[Array], v: Array | None = None
) -> tuple[InterfaceGeometry, Transfer]:
    """All anew where bodies are now, and how to carry over what was remembered; arguments as of
    ``relocated``, v tells where the old frame is now."""
    new = build(geometry.site.moved(motions))
    return new, transfer(geometry, new, v)


def transfer(old: InterfaceGeometry, new: InterfaceGeometry, v: Array | None = None) -> Transfer:
    """Between two geometries of one interface; v (m_old, gdim) moves the old frame's nodes to where
    the new one is."""
    places = []
    for before, after in zip(old.pairs, new.pairs, strict=True):
        order = np.argsort(before.dofs)
        at = np.searchsorted(before.dofs, after.dofs, sorter=order)
        at = order[np.minimum(at, len(order) - 1)]
        places.append(np.where(before.dofs[at] == after.dofs, at, -1))
    frame = csr_matrix((0, 0))
    if old.frame is not None and new.frame is not None:
        there = old.frame if v is None else old.frame.moved(v)
        frame = there.interpolation(there.locate(new.frame.x))
    sizes = tuple(len(p.nodes) for p in old.pairs)
    return Transfer(frame, tuple(places), sizes, (old.jump_directions, new.jump_directions))


def remeshed(old: InterfaceGeometry, new: InterfaceGeometry) -> tuple[Transfer, list[csr_matrix]]:
    """Between geometries of one interface on two meshes, drawn at the same places: pairs go with
    the nearest old one; against an obstacle its nodes are those of the law.

    Returns:
        The transfer, and per side (n_new, n_old) values of the old pairs at the new ones.
    """
    of = [a.interpolation(b.x) for a, b in zip(old.pairs, new.pairs, strict=True)]
    frame = of[0]
    if old.frame is not None and new.frame is not None:
        frame = old.frame.interpolation(old.frame.locate(new.frame.x))
    places = tuple(np.asarray(N.argmax(axis=1)).ravel() for N in of)
    sizes = tuple(len(p.nodes) for p in old.pairs)
    return Transfer(frame, places, sizes, (old.jump_directions, new.jump_directions)), of
