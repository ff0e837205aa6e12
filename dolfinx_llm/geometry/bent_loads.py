"""What pressures on curved surfaces exert at the nodes of second-order facets, bent as drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_llm.geometry.cells import facet_normals
from dolfinx_llm.geometry.element import Element, element_of
from dolfinx_llm.geometry.loads import UNTOLD, NodalLoads, assembled
from dolfinx_llm.geometry.overlap_curved import (
    FARTHEST,
    covered_facets,
    require_overlap,
    vector_areas_in_contact,
)
from dolfinx_llm.geometry.overlap_flat import covered_points
from dolfinx_llm.geometry.surface import Surface


def loads_in_contact(
    sides: Sequence[Surface], may_part: bool, order: int
) -> tuple[list[NodalLoads], list[np.ndarray]]:
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
    both = [_loads(a, b, reach, order) for a, b in (sides, sides[::-1])]
    loads, vectors = map(list, zip(*both, strict=True))
    require_overlap(sides, vectors)
    return loads, vectors


def _loads(
    side: Surface, other: Surface, reach: float, order: int
) -> tuple[NodalLoads, np.ndarray]:
    """Of one side, and its vector areas."""
    (n, gdim), cells, element = side.x.shape, side.cells, side.element
    facet, xi, weight, part = _points(side, other, reach)
    flat = xi.reshape(-1, gdim - 1)
    N, dN = element.shape(flat)
    e, g = weight.shape
    N, dN = N.reshape(e, g, -1), dN.reshape(e, g, element.nodes, gdim - 1)
    normal = facet_normals(side.x, cells[facet], dN) * weight[..., None]
    area, nodes = np.linalg.norm(normal, axis=2), cells[facet]
    place = np.einsum("egk,eki->egi", N, side.x[nodes])
    arm = place[:, :, None] - side.x[nodes][:, None]
    vectors = np.zeros((n, gdim))
    np.add.at(vectors, nodes, np.einsum("egi,egk->eki", normal, N))
    if element.order == 1:
        return NodalLoads.of_forces(np.linalg.norm(vectors, axis=1)), vectors
    forces, shares, sound = np.zeros(n), np.zeros(n), np.zeros(n, dtype=bool)
    moments, touched = np.zeros((n, gdim)), np.zeros(n, dtype=bool)
    np.add.at(forces, nodes, np.einsum("eg,egk->ek", area, N))
    np.add.at(moments, nodes, np.einsum("eg,egk,egki->eki", area, N, arm))
    np.add.at(shares, nodes, area.sum(axis=1)[:, None] / element.nodes)
    touched[nodes] = True
    sound[nodes[part > UNTOLD]] = True
    mass = assembled(np.einsum("eg,egk,egl->ekl", area, N, N), nodes, n)
    moments = moments if order > 1 else moments[:, :0]
    return NodalLoads(forces, shares, moments, touched, mass, sound), vectors


def _points(
    side: Surface, other: Surface, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Facets (e,), reference coordinates (e, g, d) and weights (e, g) of points in what the other
    side covers, and which part of its facet that is (e,)."""
    whole, cut = covered_facets(side, other, reach)
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


def _jacobians(s: np.ndarray, xi: np.ndarray, element: Element) -> np.ndarray:
    """(g,) of a straight facet with corners s (c, d) in its plane."""
    J = np.einsum("gkd,ki->gdi", element.shape(xi)[1], s)
    return np.asarray(np.abs(np.linalg.det(J)))


def _padded(
    found: Sequence[tuple[np.ndarray, ...]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
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
