"""What a pressure on the contact area exerts at a side's nodes: forces, and their first moments.

At first order a constant pressure passes, for which forces are enough. At second order it is
pressures linear along the surface as well: p = s - s_0 exerts ∫ N_p (s - s_0) dA at node p, which
the moment ∫ N_p (s - s_p) dA tells for any s_0. Forces of second-order facets may be zero or
negative (at the corners of triangles, beyond where the area ends): what takes part is told by
facets, not by signs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import block_diag, coo_matrix, csr_matrix

from dolfinx_llm.geometry.cells import facet_mass, facet_vectors, points_of, vector_areas
from dolfinx_llm.geometry.overlap_flat import covered_points, nodal_forces
from dolfinx_llm.geometry.surface import Surface

UNTOLD = 0.3  # part of a facet in contact, up to which it tells little of its far nodes


@dataclass(frozen=True, eq=False)
class NodalLoads:
    """Of n nodes, under unit pressure and, at second order, pressures linear along the surface."""

    forces: np.ndarray  # (n,) integrals of N_p over the area in contact [area]
    shares: np.ndarray  # (n,) area of its facets that each node stands for; forces at first order
    moments: np.ndarray  # (n, gdim - 1) integrals of N_p (s - s_p), on curved surfaces (n, gdim) of
    # N_p (x - x_p); (n, 0) at first order
    touched: np.ndarray  # (n,) whether a facet of the node is in contact
    mass: csr_matrix | None = None  # (n, n) integrals of N_p N_q of second-order facets [area]
    sound: np.ndarray | None = None  # (n,) whether one of them is by more than ``UNTOLD`` of it

    @classmethod
    def of_forces(cls, forces: np.ndarray) -> NodalLoads:
        """First order: forces (n,) are all."""
        return cls(forces, forces, np.zeros((len(forces), 0)), forces > 0.0)

    @classmethod
    def on(cls, side: Surface, s: np.ndarray, area: Any, order: int = 1) -> NodalLoads:
        """Of a flat side, exact.

        Args:
            side: the surface.
            s: (n, gdim - 1) its nodes in coordinates of the plane, in which edges are taken for
                straight [length].
            area: in contact: a polygon, in 2D an interval.
            order: 2 for moments as well.
        """
        n, cells, element = len(side.x), side.cells, side.element
        if element.order == 1:
            return cls.of_forces(nodal_forces(side, s, area))
        s = side.straightened(s)
        forces, shares, touched = np.zeros(n), np.zeros(n), np.zeros(n, dtype=bool)
        moments, products, sound = np.zeros((n, s.shape[1])), [], np.zeros(n, dtype=bool)
        whole = np.ptp(s[side.facets][..., 0], axis=1)
        if s.shape[1] > 1:
            whole = np.linalg.norm(vector_areas(s, side.facets), axis=1)
        covered = np.zeros(len(cells))
        for facet, xi, weight in covered_points(s, side.facets, area):
            nodes, (e, g, d) = cells[facet], xi.shape
            on_facet, flat = np.repeat(side.facets[facet], g, axis=0), xi.reshape(-1, d)
            x = points_of(s, on_facet, flat)[1].reshape(e, g, d)
            N = element.shape(flat)[0].reshape(e, g, element.nodes)
            wN = weight[..., None] * N
            arm = x[:, :, None] - s[nodes][:, None]
            np.add.at(forces, nodes, wN.sum(axis=1))
            np.add.at(shares, nodes, weight.sum(axis=1)[:, None] / element.nodes)
            np.add.at(moments, nodes, np.einsum("egk,egkd->ekd", wN, arm))
            touched[nodes] = True
            np.add.at(covered, facet, weight.sum(axis=1))
            products.append(assembled(np.einsum("egk,egl->ekl", wN, N), nodes, n))
        sound[cells[covered > UNTOLD * whole]] = True
        moments = moments if order > 1 else moments[:, :0]
        return cls(forces, shares, moments, touched, sum(products), sound)

    @classmethod
    def whole(cls, side: Surface, facets: np.ndarray) -> NodalLoads:
        """Of some facets of a side, flat or curved, as wholes: no moments."""
        n, cells = len(side.x), side.cells[facets]
        if side.element.order == 1:
            vectors = np.zeros_like(side.x)
            np.add.at(vectors, cells, facet_vectors(side.x, cells))
            return cls.of_forces(np.linalg.norm(vectors, axis=1))
        blocks, touched = facet_mass(side.x, cells), np.zeros(n, dtype=bool)
        touched[cells] = True
        mass = assembled(blocks, cells, n)
        area = np.repeat(blocks.sum(axis=(1, 2)) / side.element.nodes, side.element.nodes)
        shares = np.bincount(cells.ravel(), area, n)
        return cls(mass @ np.ones(n), shares, np.zeros((n, 0)), touched, mass, touched)

    def of(self, nodes: np.ndarray) -> NodalLoads:
        """Those of some nodes."""
        mass = None if self.mass is None else self.mass[nodes][:, nodes].tocsr()
        sound = None if self.sound is None else self.sound[nodes]
        own = self.forces[nodes], self.shares[nodes], self.moments[nodes], self.touched[nodes]
        return NodalLoads(*own, mass, sound)

    @staticmethod
    def joined(loads: Sequence[NodalLoads]) -> NodalLoads:
        """Of several sets of nodes, one after the other."""
        forces, shares, moments, touched = (
            np.concatenate([getattr(load, name) for load in loads])
            for name in ("forces", "shares", "moments", "touched")
        )
        blocks = [load.mass for load in loads]
        whole = None if blocks[0] is None else csr_matrix(block_diag(blocks, format="csr"))
        sound = None if whole is None else np.concatenate([load.sound for load in loads])
        return NodalLoads(forces, shares, moments, touched, whole, sound)


def assembled(blocks: np.ndarray, nodes: np.ndarray, n: int) -> csr_matrix:
    """(n, n) sum of blocks (e, k, k) at nodes (e, k)."""
    row = np.broadcast_to(nodes[:, :, None], blocks.shape).ravel()
    col = np.broadcast_to(nodes[:, None, :], blocks.shape).ravel()
    return coo_matrix((blocks.ravel(), (row, col)), (n, n)).tocsr()
