"""Friction on a rigid obstacle, which drags along what it moves and turns.

What node p touched at the start is a point of the obstacle as drawn, X⁰_p, now carried to
pivot + shift + R (X⁰_p - pivot). There is no slip where body and obstacle move as one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.sparse import per_item
from dolfinx_llm.finite.areas import everything, surface_integrals
from dolfinx_llm.finite.friction import MET_AT, Friction
from dolfinx_llm.finite.jacobians import coordinates, jacobian
from dolfinx_llm.finite.obstacle_contact import ObstacleContact, ObstaclePlace
from dolfinx_llm.finite.terms import Held, Origin
from dolfinx_llm.geometry.cells import cell_sizes
from dolfinx_llm.interface.against import checked_clearance


@dataclass(frozen=True, eq=False)
class ObstacleFriction(Friction, ObstacleContact):
    """Points of the obstacle are written as drawn, (n, gdim)."""

    def started(self, place: ObstaclePlace, held: Held, closed: np.ndarray) -> Origin:
        """Where slip counts from: the obstacle stands where the increment starts."""
        surface = self.sides.surfaces[0]
        X = self.posed(held.pose_before).back(self.sides.split(place.z)[0])
        gap = self.sides.control @ checked_clearance(self.obstacle, X)[0]
        gap[gap < MET_AT * cell_sizes(surface.x, surface.facets).max()] = 0.0
        return Origin(self.sides.control @ X, gap, closed)

    def here(self, place: ObstaclePlace) -> np.ndarray:
        """(n, gdim) where the nodes' places were drawn [length]."""
        return self.sides.control @ place.pose.back(self.sides.split(place.z)[0])

    def way(self, place: ObstaclePlace, origin: Origin) -> tuple[np.ndarray, csr_matrix]:
        x = self.sides.control @ self.sides.split(place.z)[0]
        way = x - place.pose.on(origin.points)
        return way, self.sides.jumps(place.N)

    def turned(self, place: ObstaclePlace, nodes: np.ndarray) -> csr_matrix:
        own = coordinates(nodes[:, None], self.sides.gdim)
        return jacobian(place.turned[nodes], own, len(place.z))

    def growth(self, place: ObstaclePlace, nodes: np.ndarray) -> csr_matrix:
        x, surface = self.sides.split(place.z)[0], self.sides.surfaces[0]
        area, by_x = surface_integrals(x, surface, everything(x, surface, 0, x.size), 0)
        unit = area / np.maximum(np.linalg.norm(area, axis=1), 1e-300)[:, None]
        return (per_item(unit[:, None]) @ by_x)[nodes]
