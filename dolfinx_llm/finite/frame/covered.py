"""Parts of facets that are covered, by the integrals of shape functions there; with a thickness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, per_item
from dolfinx_llm.finite.frame.bernstein import with_linear
from dolfinx_llm.finite.frame.jacobians import coordinates, jacobian
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.geometry.thickness import slope_at

SLOPE_OVER = 1e-3  # of a surface's size, over which the slope of its thickness is taken


@dataclass(frozen=True, eq=False)
class Covered:
    """Covered parts of facets: integrals of shape functions there, over the facet's size."""

    share: Array  # (f, j); their sum is 1 where the whole facet is covered
    derivative: csr_matrix  # (j f, width) by all coordinates [1 / length]

    def without(self, other: Covered) -> Covered:
        """What of these parts does not belong to other ones, which lie in them."""
        return Covered(self.share - other.share, self.derivative - other.derivative)

    def of(self, facets: Array) -> Covered:
        """The same of facets (f,) that are among these, and nothing of others."""
        each = np.repeat(facets, self.share.shape[1])
        return Covered(self.share * facets[:, None], diagonal(each) @ self.derivative)

    def times(self, factor: float) -> Covered:
        """The same times a factor."""
        return Covered(factor * self.share, factor * self.derivative)


def integrated(surface: Surface) -> int:
    """Degree of Bernstein's functions that are integrated over parts of facets in the plane: their
    own; where the thickness varies that of products with it."""
    return surface.element.order + callable(surface.depth)


def with_thickness(covered: Covered, x: Array, surface: Surface, first: int) -> Covered:
    """Integrals of the facets' functions times the thickness, linear between corners, from those of
    ``integrated``. Arguments as for ``surface_integrals``."""
    given, cells, degree = surface.depth, surface.facets, surface.element.order
    if not callable(given):
        return covered if given in (None, 1.0) else covered.times(given)
    B, f = covered.share, len(cells)
    slope = slope_at(given, x + surface.origin, SLOPE_OVER * surface.diameter)[cells]
    factor = with_linear(degree, np.asarray(surface.thickness_at(x))[cells])
    by_t = np.stack([with_linear(degree, np.tile(e, (f, 1))) for e in np.eye(2)], axis=3)
    by_t = np.einsum("fjbt,fb->fjt", by_t, B)
    by_x = (by_t[:, :, :, None] * slope[:, None]).reshape(f, degree + 1, 4)
    change = per_item(factor) @ covered.derivative
    change = change + jacobian(by_x, coordinates(cells, 2, first), change.shape[1])
    return Covered(np.einsum("fjb,fb->fj", factor, B), change)
