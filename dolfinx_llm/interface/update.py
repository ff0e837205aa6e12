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
        before, now = self.directions
        vectors = np.einsum("kq,kqi->ki", jumps, before)
        return self.scale * np.einsum("ki,kqi->kq", self.nodes @ vectors, now)


def remeshed(old: InterfaceGeometry, new: InterfaceGeometry) -> tuple[Transfer, list[csr_matrix]]:
    """Between geometries of one interface on two meshes, drawn at the same places: pairs go with
    the nearest old one.

    Returns:
        The transfer, and per side (n_new, n_old) values of the old pairs at the new ones.
    """
    of = [a.interpolation(b.x) for a, b in zip(old.pairs, new.pairs, strict=True)]
    nodes = old.at_law_nodes(new.law_nodes[0])
    places = tuple(np.asarray(N.argmax(axis=1)).ravel() for N in of)
    sizes = tuple(len(p.nodes) for p in old.pairs)
    directions, scale = (old.jump_directions, new.jump_directions), new.theta / old.theta
    return Transfer(nodes, places, sizes, directions, scale), of
