"""An interface on another mesh of its bodies: what it remembers is carried over."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.interface.geometry import InterfaceGeometry


@dataclass(frozen=True, eq=False)
class Transfer:
    """How what an interface remembers goes from one geometry to the next."""

    nodes: csr_matrix  # (k_new, k_old) values at the nodes of the law
    frame: csr_matrix | None  # (m_new, m_old) the same of motions of the frame, or about a mean;
    # None against an obstacle
    ahead: csr_matrix | None  # (m_new, k_old) by how many jumps there a frame that another side
    # carries is ahead of the old one; None: the same side carries it
    pairs: tuple[Array, ...]  # per side (n_new,) place among the old pairs
    sizes: tuple[int, ...]  # pairs per side before
    directions: tuple[Array, Array]  # (k, q, gdim) of jumps, before and now
    scale: float  # unknowns of jumps now over those before

    @property
    def old_pairs(self) -> Array:
        """(n_new,) place among the old pairs of all sides."""
        first = np.cumsum((0, *self.sizes[:-1]))
        return np.concatenate([at + k for at, k in zip(self.pairs, first, strict=True)])

    def turned(self, jumps: Array) -> Array:
        """(k_new, q) jumps along the directions of now, from (k_old, q) along the old ones."""
        vectors = self.nodes @ self._vectors(jumps)
        return self.scale * np.einsum("ki,kqi->kq", vectors, self.directions[1])

    def moved(self, v: Array, jumps: Array) -> Array:
        """(m_new, gdim) motion of the frame from that of the old one (m_old, gdim), where its law
        has jumps (k_old, q)."""
        own = self.frame @ v
        return own if self.ahead is None else own + self.ahead @ self._vectors(jumps)

    def _vectors(self, jumps: Array) -> Array:
        """(k_old, gdim) of jumps (k_old, q)."""
        return np.einsum("kq,kqi->ki", jumps, self.directions[0])


def remeshed(old: InterfaceGeometry, new: InterfaceGeometry) -> tuple[Transfer, list[csr_matrix]]:
    """Between geometries of one interface on two meshes, drawn at the same places: pairs go with
    the nearest old one.

    Returns:
        The transfer, and per side (n_new, n_old) values of the old pairs at the new ones.
    """
    of = [a.interpolation(b.x) for a, b in zip(old.pairs, new.pairs, strict=True)]
    nodes, frame, ahead = old.at_law_nodes(new.law_nodes[0]), None, None
    if old.frame is not None and new.frame is not None:
        frame = old.frame.interpolation(old.frame.locate(new.frame.x))
        way = (_ahead(new) - _ahead(old)) / old.theta
        ahead = way * old.at_law_nodes(new.frame.x) if way else None
    elif old.interface.obstacle is not None and old.interface.obstacle.everywhere:
        frame = (of[0] @ old.pairs[0].N)[new.about_mean]
    places = tuple(np.asarray(N.argmax(axis=1)).ravel() for N in of)
    sizes = tuple(len(p.nodes) for p in old.pairs)
    directions, scale = (old.jump_directions, new.jump_directions), new.theta / old.theta
    return Transfer(nodes, frame, ahead, places, sizes, directions, scale), of


def _ahead(geometry: InterfaceGeometry) -> float:
    """Part of the way of side 0 along side 1 by which a frame is ahead of the middle of both."""
    return {None: 0.0, 0: 0.5, 1: -0.5}[geometry.site.carrier]
