"""What a pressure on the contact area exerts at a side's nodes: forces, and their first moments.

At first order a constant pressure passes, for which forces are enough. At second order it is
pressures linear along the surface as well: p = s - s_0 exerts ∫ N_p (s - s_0) dA at node p, which
the moment ∫ N_p (s - s_p) dA tells for any s_0. Of 9-node facets those of degree 2 as well: a
corner stands for a 36th of a facet, and shows what the others leave as a pressure of its own.
Forces of second-order facets may be zero or negative (at the corners of triangles, beyond where the
area ends): what takes part is told by facets, not by signs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import block_diag, csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import placed
from dolfinx_llm.geometry.cells import (
    facet_mass,
    facet_normals,
    facet_vectors,
    points_of,
    vector_areas,
)
from dolfinx_llm.geometry.element import Element, element_of
from dolfinx_llm.geometry.overlap_curved import (
    FARTHEST,
    covered_facets,
    require_overlap,
    vector_areas_in_contact,
)
from dolfinx_llm.geometry.overlap_flat import Plane, covered_points, nodal_forces
from dolfinx_llm.geometry.surface import Surface


@dataclass(frozen=True, eq=False)
class NodalLoads:
    """Of n nodes, under unit pressure and, at second order, pressures linear along the surface."""

    forces: Array  # (n,) integrals of N_p over the area in contact [area]
    shares: Array  # (n,) area of its facets that each node stands for; forces at first order
    moments: Array  # (n, gdim - 1) integrals of N_p (s - s_p), on curved surfaces (n, gdim) of
    # N_p (x - x_p); (n, 0) at first order
    touched: Array  # (n,) whether a facet of the node is in contact
    mass: csr_matrix | None = None  # (n, n) integrals of N_p N_q of second-order facets [area]
    cover: Array | None = None  # (n,) part in contact of that second-order facet of the node of
    # which most is
    second: Array | None = None  # (n, 3) integrals of N_p (s - s_p)_i (s - s_p)_j, i >= j, of flat
    # 9-node facets

    @classmethod
    def of_forces(cls, forces: Array) -> NodalLoads:
        """First order: forces (n,) are all."""
        return cls(forces, forces, np.zeros((len(forces), 0)), forces > 0.0)

    @classmethod
    def on(
        cls, side: Surface, s: Array, area: Any, order: int = 1, thickness: Array | None = None
    ) -> NodalLoads:
        """Of a flat side, exact.

        Args:
            side: the surface.
            s: (n, gdim - 1) its nodes in coordinates of the plane, in which edges are taken for
                straight [length].
            area: in contact: a polygon, in 2D an interval.
            order: 2 for moments as well.
            thickness: (n,) at s, of both sides the same function of the plane; None: 1 [length].
        """
        n, cells, element = len(side.x), side.cells, side.element
        if element.order == 1:
            return cls.of_forces(nodal_forces(side, s, area, thickness))
        s = side.straightened(s)
        if thickness is not None:
            thickness = side.straightened(thickness)
        forces, shares, touched = np.zeros(n), np.zeros(n), np.zeros(n, dtype=bool)
        moments, products = np.zeros((n, s.shape[1])), []
        second = np.zeros((n, 3)) if order > 1 and element.nodes == 9 else None
        whole = np.ptp(s[side.facets][..., 0], axis=1)
        if s.shape[1] > 1:
            whole = np.linalg.norm(vector_areas(s, side.facets), axis=1)
        covered = np.zeros(len(cells))
        for facet, xi, weight in covered_points(s, side.facets, area):
            nodes, (e, g, d) = cells[facet], xi.shape
            on_facet, flat = np.repeat(side.facets[facet], g, axis=0), xi.reshape(-1, d)
            x = points_of(s, on_facet, flat)[1].reshape(e, g, d)
            N = element.shape(flat)[0].reshape(e, g, element.nodes)
            covered += np.bincount(facet, weight.sum(axis=1), len(cells))
            if thickness is not None:
                weight = weight * np.einsum("egk,ek->eg", N, thickness[nodes])
            wN = weight[..., None] * N
            arm = x[:, :, None] - s[nodes][:, None]
            np.add.at(forces, nodes, wN.sum(axis=1))
            np.add.at(shares, nodes, weight.sum(axis=1)[:, None] / element.nodes)
            np.add.at(moments, nodes, np.einsum("egk,egkd->ekd", wN, arm))
            if second is not None:
                arms = np.stack(squares(arm), axis=-1)
                np.add.at(second, nodes, np.einsum("egk,egkq->ekq", wN, arms))
            touched[nodes] = True
            products.append(assembled(np.einsum("egk,egl->ekl", wN, N), nodes, n))
        cover = _most(covered / whole, cells, n)
        moments = moments if order > 1 else moments[:, :0]
        return cls(forces, shares, moments, touched, sum(products), cover, second)

    @classmethod
    def over(cls, side: Surface, plane: Plane, area: Any, order: int = 1) -> NodalLoads:
        """The same in a plane of contact, with the thickness there: of both sides one function."""
        s = plane.project(side.x)
        return cls.on(side, s, area, order, side.thickness_at(plane.lift(s)))

    @classmethod
    def whole(cls, side: Surface, facets: Array) -> NodalLoads:
        """Of some facets of a side, flat or curved, as wholes: no moments."""
        n, cells = len(side.x), side.cells[facets]
        if side.element.order == 1:
            vectors = np.zeros_like(side.x)
            np.add.at(vectors, cells, facet_vectors(side.x, cells, side.thickness))
            return cls.of_forces(np.linalg.norm(vectors, axis=1))
        blocks, touched = facet_mass(side.x, cells, side.thickness), np.zeros(n, dtype=bool)
        touched[cells] = True
        mass = assembled(blocks, cells, n)
        area = np.repeat(blocks.sum(axis=(1, 2)) / side.element.nodes, side.element.nodes)
        shares = np.bincount(cells.ravel(), area, n)
        forces, cover = mass @ np.ones(n), touched.astype(float)
        return cls(forces, shares, np.zeros((n, 0)), touched, mass, cover)

    def of(self, nodes: Array) -> NodalLoads:
        """Those of some nodes."""
        mass = None if self.mass is None else self.mass[nodes][:, nodes].tocsr()
        cover = None if self.cover is None else self.cover[nodes]
        own = self.forces[nodes], self.shares[nodes], self.moments[nodes], self.touched[nodes]
        return NodalLoads(*own, mass, cover, None if self.second is None else self.second[nodes])

    def linear(self) -> NodalLoads:
        """The same without those of degree 2."""
        return replace(self, second=None)

    @staticmethod
    def joined(loads: Sequence[NodalLoads]) -> NodalLoads:
        """Of several sets of nodes, one after the other."""
        forces, shares, moments, touched = (
            np.concatenate([getattr(load, name) for load in loads])
            for name in ("forces", "shares", "moments", "touched")
        )
        blocks = [load.mass for load in loads]
        whole = None if blocks[0] is None else csr_matrix(block_diag(blocks, format="csr"))
        cover = None if whole is None else np.concatenate([load.cover for load in loads])
        squared = [load.second for load in loads if load.second is not None]
        second = np.concatenate(squared) if len(squared) == len(loads) else None
        return NodalLoads(forces, shares, moments, touched, whole, cover, second)


def squares(x: Array) -> list[Array]:
    """x_i x_j, i >= j, of vectors x (..., d).

    >>> [float(v) for v in squares(np.array([2.0, 3.0]))]
    [4.0, 6.0, 9.0]
    """
    return [x[..., i] * x[..., j] for i in range(x.shape[-1]) for j in range(i + 1)]


def assembled(blocks: Array, nodes: Array, n: int) -> csr_matrix:
    """(n, n) sum of blocks (e, k, k) at nodes (e, k)."""
    return placed(blocks, nodes[:, :, None], nodes[:, None, :], (n, n))


def loads_in_contact(
    sides: Sequence[Surface], may_part: bool, order: int
) -> tuple[list[NodalLoads], list[Array]]:
    """Of both sides, over what both cover, and (n_i, gdim) vector areas of their nodes.

    Args:
        sides: the two surfaces.
        may_part: see ``vector_areas_in_contact``.
        order: of the fields that pass: 2 for moments, of vectors (n_i, gdim), as well.

    Raises:
        ContactError: see ``vector_areas_in_contact``.
    """
    if all(side.element.order == 1 for side in sides):
        vectors = vector_areas_in_contact(sides[0], sides[1], may_part)
        return [NodalLoads.of_forces(np.linalg.norm(a, axis=1)) for a in vectors], vectors
    reach = np.inf if may_part else FARTHEST
    both = [covered_loads(a, b, reach, order) for a, b in (sides, sides[::-1])]
    loads, vectors = map(list, zip(*both, strict=True))
    require_overlap(sides, vectors)
    return loads, vectors


def covered_loads(
    side: Surface, other: Surface, reach: float, order: int, as_is: bool = False
) -> tuple[NodalLoads, Array]:
    """Of one side, over what the other one covers, and its vector areas; see ``covered_facets``."""
    (n, gdim), cells, element = side.x.shape, side.cells, side.element
    facet, xi, weight, part = _points(side, covered_facets(side, other, reach, as_is))
    flat = xi.reshape(-1, gdim - 1)
    N, dN = element.shape(flat)
    e, g = weight.shape
    N, dN = N.reshape(e, g, element.nodes), dN.reshape(e, g, element.nodes, gdim - 1)
    normal, nodes = facet_normals(side.x, cells[facet], dN), cells[facet]
    if side.thickness is not None:
        weight = weight * np.einsum("egk,ek->eg", N, side.thickness[nodes])
    area = np.linalg.norm(normal, axis=2) * weight  # weights of parts cut off are negative
    normal = normal * weight[..., None]
    place = np.einsum("egk,eki->egi", N, side.x[nodes])
    arm = place[:, :, None] - side.x[nodes][:, None]
    vectors = np.zeros((n, gdim))
    np.add.at(vectors, nodes, np.einsum("egi,egk->eki", normal, N))
    if element.order == 1:
        return NodalLoads.of_forces(np.linalg.norm(vectors, axis=1)), vectors
    forces, shares = np.zeros(n), np.zeros(n)
    moments, touched = np.zeros((n, gdim)), np.zeros(n, dtype=bool)
    np.add.at(forces, nodes, np.einsum("eg,egk->ek", area, N))
    np.add.at(moments, nodes, np.einsum("eg,egk,egki->eki", area, N, arm))
    np.add.at(shares, nodes, area.sum(axis=1)[:, None] / element.nodes)
    touched[nodes] = True
    cover = _most(np.bincount(facet, part, len(cells)), cells, n)
    mass = assembled(np.einsum("eg,egk,egl->ekl", area, N, N), nodes, n)
    moments = moments if order > 1 else moments[:, :0]
    return NodalLoads(forces, shares, moments, touched, mass, cover), vectors


def _most(part: Array, cells: Array, n: int) -> Array:
    """(n,) largest part in contact (m,) of the facets (m, k) of each node."""
    most = np.zeros(n)
    np.maximum.at(most, cells, np.clip(part, 0.0, 1.0)[:, None])
    return most


def _points(
    side: Surface, covered: tuple[Array, list[tuple[int, Array, list[Any]]]]
) -> tuple[Array, Array, Array, Array]:
    """Facets (e,), reference coordinates (e, g, d) and weights (e, g) of points in what is covered,
    and which part of its facet that is (e,)."""
    whole, cut = covered
    own, w = side.element.quadrature
    facets = np.flatnonzero(whole)
    found = [(
        facets, np.broadcast_to(own, (len(facets), *own.shape)),
        np.broadcast_to(w, (len(facets), len(w))), np.ones(len(facets)),
    )]  # fmt: skip
    c = side.facets.shape[1]
    straight, cell = element_of(own.shape[1], c), np.arange(c)[None, :]
    for f, s, pieces in cut:
        size = float(_jacobians(s, own, straight) @ w)
        for piece in pieces:
            for _, xi, weight in covered_points(s, cell, piece):
                flat, weight = xi.reshape(1, -1, xi.shape[-1]), weight.reshape(1, -1)
                if not weight.size:
                    continue
                by_area = weight / _jacobians(s, flat[0], straight)
                part = np.atleast_1d(weight.sum() / size)
                found.append((np.atleast_1d(f), flat, by_area, part))
    return _padded(found)


def _jacobians(s: Array, xi: Array, element: Element) -> Array:
    """(g,) of a straight facet with corners s (c, d) in its plane."""
    J = np.einsum("gkd,ki->gdi", element.shape(xi)[1], s)
    return np.asarray(np.abs(np.linalg.det(J)))


def _padded(
    found: Sequence[tuple[Array, ...]],
) -> tuple[Array, Array, Array, Array]:
    """One array each, where facets have different numbers of points, with weights 0 of more."""
    most = max(weight.shape[1] for _, _, weight, _ in found)
    facet, xi, weight, part = (
        np.concatenate(parts)
        for parts in zip(
            *(
                (
                    f,
                    np.pad(x, ((0, 0), (0, most - x.shape[1]), (0, 0)), mode="edge"),
                    np.pad(w, ((0, 0), (0, most - w.shape[1]))),
                    p,
                )
                for f, x, w, p in found
            ),
            strict=True,
        )
    )
    return facet, xi, weight, part
