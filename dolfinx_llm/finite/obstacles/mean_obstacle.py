"""Mean displacements of surfaces at finite deformation, in the place of rigid obstacles.

With f_p the integrals of shape functions over the surface as drawn, of area A, a traction that is
uniform there and keeps its direction does work on the mean displacement alone. Its sum q_k along
each axis k with a prescribed mean is an unknown,

    f_p q_k / A on node p,   sum_p f_p (x_p - X_p)_k / A = mean_k.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix, kron

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstacleContact, ObstaclePlace, OneSide
from dolfinx_llm.finite.pairs.terms import Bound, ContactTerms, Held, held_fast
from dolfinx_llm.geometry.cells import areas_around, facet_vectors
from dolfinx_llm.geometry.loads import NodalLoads
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.against import check_mean
from dolfinx_llm.interface.obstacles import MeanDisplacement


@dataclass(frozen=True, eq=False)
class MovingMean(Bound, ObstacleContact):
    """Unknowns: the sums of the traction along the prescribed axes [force]."""

    obstacle: MeanDisplacement
    axes: Array  # (c, gdim) that are prescribed
    weights: Array  # (n,) f / A

    @classmethod
    def over(cls, surface: Surface, mean: MeanDisplacement) -> MovingMean:
        """The mean of a surface, as drawn."""
        gdim = surface.x.shape[1]
        f = NodalLoads.whole(surface, np.arange(len(surface.facets))).forces
        none = (False,) * len(mean.pose(gdim)[0] + mean.pose(gdim)[1])
        return cls(OneSide((surface,)), mean, none, mean.axes(gdim), f / f.sum())

    @property
    def size(self) -> int:
        return len(self.axes)

    @property
    def owner(self) -> Array:
        return np.full(len(self.axes), self.sides.surfaces[0].owner[0])

    def pose(self) -> Array:
        check_mean(self.obstacle, self.axes)
        return super().pose()

    def place(self, z: Array, q: Array, held: Held) -> ObstaclePlace:
        """Where the surface is: its displacement is its mean, normals and areas are its own."""
        surface, gdim = self.sides.surfaces[0], self.sides.gdim
        x = z.reshape(-1, gdim)
        vectors = areas_around(x, surface.facets, surface.cells)
        sizes = np.maximum(np.linalg.norm(vectors, axis=1), 1e-300)
        of_facets = facet_vectors(x, surface.facets, surface.thickness_at(x))
        area = np.linalg.norm(of_facets.sum(axis=1), axis=1).sum()
        shift, inward = self.weights @ (x - surface.x), -vectors / sizes[:, None]
        return ObstaclePlace(
            z=z,
            gap=np.zeros(len(x)),
            normal=inward,
            N=csr_matrix((len(x), 0)),
            areas=(self.weights * area, np.zeros(0)),
            by_x=inward,
            turned=np.zeros((len(x), gdim, gdim)),
            pose=replace(self.posed(held.pose), shift=shift, R=np.eye(gdim)),
        )

    def terms(
        self, place: ObstaclePlace, q: Array, status: Array, held: Held, free: Array
    ) -> ContactTerms:
        """All that Newton's iteration asks for; arguments as for an obstacle that is moved."""
        means = kron(self.weights[None], self.axes, format="csr")
        closed = ~held_fast(means, free)
        missing = self.axes @ (place.pose.shift - self.posed(held.pose).shift)
        B = diagonal(closed) @ means
        return ContactTerms(
            force=B.T @ q,
            K=csr_matrix((len(free), len(free))),
            top=-B.T.tocsr(),
            left=B,
            own=diagonal(~closed / held.scale),
            rest=np.where(closed, missing, q / held.scale),
            place=place,
            delta=0.0,
            status=status,
            friction=None,
        )
