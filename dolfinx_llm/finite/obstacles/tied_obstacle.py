"""Ties to rigid obstacles at finite deformation: rigid ends of bodies, which turn by any angle.

Node p stays at the point of the obstacle that it touches as drawn, X_p, wherever that is carried:
x_p = c + s + R (X_p - c) about the pivot c. Where a force F or a moment M about the moved pivot is
prescribed, components of s and of the rotation vector θ of R are found. With f_p the force on p,

    sum f_p = F,   sum R (X_p - c) × f_p = M,   d(R a) = (T(θ) dθ) × R a.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import bmat, csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstaclePlace, OneSide
from dolfinx_llm.finite.obstacles.pose import Pose
from dolfinx_llm.finite.obstacles.pressed_obstacle import Pressed
from dolfinx_llm.finite.pairs.terms import Bound, ContactTerms, Held
from dolfinx_llm.finite.pairs.tied_contact import DRAWN, LITTLE_AREA, determined
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.against import (
    RESISTED,
    against_obstacle,
    checked_clearance,
    loaded,
)
from dolfinx_llm.interface.obstacle import Obstacle, turned
from dolfinx_llm.interface.rounds import round_advice

CLOSINGS = 20  # steps onto an obstacle whose clearance is an estimate
SERIES_BELOW = 0.1  # angle below which (1 - sin(a) / a) / a² is a series [rad]
RISE = 2.0  # times what facets cut off a curved surface, up to which a node is on it


@dataclass(frozen=True, eq=False)
class TiedObstacle(Bound, Pressed):
    """Unknowns: a force of gdim components per node, at second order of control values, then the
    motions of the obstacle that forces and moments are prescribed for, as lengths."""

    leans = np.inf  # it bears any force

    tied: Array  # (n,) nodes that are
    points: Array  # (n, gdim) of the obstacle that they touch, as drawn [length]
    directions: Array  # (n, gdim) out of the obstacle there, as drawn

    @classmethod
    def between(
        cls, surface: Surface, obstacle: Obstacle, name: str, close_gap: bool
    ) -> TiedObstacle:
        """The tie of a surface, as drawn.

        Args:
            surface, obstacle: what is tied.
            name: of the interface.
            close_gap: close gaps of the drawing.

        Raises:
            ContactError: the surface does not face the obstacle within a facet's size, or what is
                tied cannot bear forces and moments on the obstacle.
            ContactInputError: there are gaps that are not to be closed.
        """
        pairs, _ = against_obstacle(obstacle, surface, name, [])
        size = surface.facet_size
        tied = np.isin(np.arange(len(surface.x)), pairs.nodes)
        gap, into = checked_clearance(obstacle, surface.x)
        contact = cls(
            OneSide((surface,)), obstacle, loaded(obstacle, len(into.T)), tied, surface.x, -into
        )
        off = tied & (np.abs(gap) > np.maximum(RISE * np.abs(contact.rise), DRAWN * size))
        far, what = np.abs(gap[off]).max(initial=0.0), type(obstacle).__name__
        if far > size:
            raise ContactError(
                f"{surface.name} and the {what}, which are to be tied, lie up to {far:.3g} apart, "
                f"more than a facet's size, {size:.3g}. Check tags, positions and units"
                f"{round_advice(surface)}"
            )
        if off.any() and not close_gap:
            raise ContactInputError(
                f"{surface.name} and the {what} are drawn with gaps of up to {far:.3g}: at finite "
                "deformation choose Tied(close_gap=True), or draw them in touch"
                f"{round_advice(surface)}"
            )
        points = surface.x.copy()
        for _ in range(CLOSINGS if off.any() else 0):
            gap, into = checked_clearance(obstacle, points[off])
            points[off] += gap[:, None] * into
        contact = replace(contact, points=points)
        contact.check_borne()
        return contact

    def reading(self, given: Any) -> TiedObstacle:
        """The same to the obstacle as it is drawn at the start of a load step.

        Args:
            given: tied anew, see ``between``.
        """
        return replace(self, tied=given.tied, points=given.points, directions=given.directions)

    def check_borne(self) -> None:
        """Require nodes that can bear what is prescribed on the obstacle.

        Raises:
            ContactError: they cannot.
        """
        if not len(self.axes):
            return
        moves = self.moves(self.posed(self.pose()))[0][self.tied]
        size = np.linalg.svd(moves.reshape(-1, len(self.axes)), compute_uv=False)
        if len(size) < len(self.axes) or size[-1] <= RESISTED * size[0]:
            raise ContactError(
                f"the {int(self.tied.sum())} node(s) of {self.sides.surfaces[0].name} that are "
                f"tied to the {type(self.obstacle).__name__} do not bear forces and moments on it "
                f"by component as {self.forced}: they lie on a line, or are too few. Give None for "
                "components that are to be prescribed"
            )

    @property
    def size(self) -> int:
        return int(self.points.size) + len(self.axes)

    @property
    def owner(self) -> Array:
        nodes = self.sides.surfaces[0].owner
        return np.concatenate([np.repeat(nodes, self.sides.gdim), 0 * self.axes])

    def carried(self, q: Array, R: Array) -> Array:
        return (q.reshape(-1, len(R)) @ R.T).ravel()  # where nothing yields

    def led(self, pose: Array) -> tuple[Array, Array] | None:
        tied = np.repeat(self.pairs, self.sides.gdim)
        return None if len(self.axes) else (tied, self.posed(pose).on(self.points).ravel())

    @property
    def pairs(self) -> Array:
        """(n,) control values that are tied: all that they are made of is."""
        return self.tied & (abs(self.sides.control) @ ~self.tied == 0.0)

    def place(self, z: Array, q: Array, held: Held) -> ObstaclePlace:
        """The pairs where the obstacle is; normals are its own, areas those of the body now."""
        surface = self.sides.surfaces[0]
        n, gdim = self.points.shape
        pose = self.posed(self.placing(held.pose, q))
        cells = surface.cells[self.tied[surface.cells].all(axis=1)]
        vectors = self.vectors(z.reshape(n, gdim), cells)
        normal = self.directions @ pose.R.T
        return ObstaclePlace(
            z=z,
            gap=np.where(self.pairs, 0.0, np.inf),
            normal=normal,
            N=csr_matrix((n, 0)),
            areas=(np.linalg.norm(vectors, axis=1), np.zeros(0)),
            by_x=normal,
            turned=np.zeros((n, gdim, gdim)),
            pose=pose,
        )

    def moves(self, pose: Pose) -> tuple[Array, Array]:
        """(n, gdim, f) how the points move with the motions, and the same of a rotation by space's
        axes, by which forces have moments."""
        gdim, arm = self.sides.gdim, (self.points - pose.pivot) @ pose.R.T
        shifts = np.broadcast_to(np.eye(gdim), (len(arm), gdim, gdim))
        both = []
        for axes in (spins(pose.turn), np.eye(len(pose.turn))):
            swings = np.stack([turned(arm, axis) for axis in axes.T], axis=2)
            every = np.concatenate([shifts, swings], axis=2)
            both.append(every[:, :, self.axes] * self.units)
        return both[0], both[1]

    def terms(
        self, place: ObstaclePlace, q: Array, status: Array, held: Held, free: Array
    ) -> ContactTerms:
        """All that Newton's iteration asks for; arguments as for an obstacle that is moved."""
        gdim, k, c = self.sides.gdim, self.points.size, held.scale
        by_move, arms = self.moves(place.pose)
        P, rest = self._determined(by_move, free, place.areas[0])
        A, own, q = (P.T @ self.sides.jumps(place.N)).tocsr(), rest / c, q[:k]
        moves, W = (csr_matrix(a.reshape(k, -1)) for a in (by_move, arms))
        force = A.T @ q
        bends = np.zeros((len(self.axes),) * 2)  # how moments change where arms turn
        swung = np.flatnonzero(self.axes >= gdim)
        for i in swung:
            axis = np.eye(1 if gdim == 2 else 3)[self.axes[i] - gdim] * self.units[i]
            for j in swung:
                bends[i, j] = (turned(by_move[:, :, j], axis) * force.reshape(-1, gdim)).sum()
        balance = (self.pressing(held) - W.T @ force) / c
        return ContactTerms(
            force=force,
            K=csr_matrix((k, k)),
            top=bmat([[-A.T, csr_matrix((k, len(balance)))]], format="csr"),
            left=bmat([[A], [csr_matrix((len(balance), k))]], format="csr"),
            own=bmat([[own, -A @ moves], [-(A @ W).T / c, csr_matrix(-bends / c)]], format="csr"),
            rest=np.concatenate(
                [A @ (place.z - place.pose.on(self.points).ravel()) + own @ q, balance]
            ),
            place=place,
            delta=0.0,
            status=status,
            friction=None,
            miss=float(np.abs(balance).max(initial=0.0)) * c,
        )

    def _determined(self, moves: Array, free: Array, area: Array) -> tuple[csr_matrix, csr_matrix]:
        """P and D as of a tie between bodies: what prescribed nodes tell of an obstacle that is
        found counts once, and nothing where that is moved."""
        tied = np.repeat(self.pairs, self.sides.gdim)
        at = np.flatnonzero(tied & ~free)
        P, D = diagonal(tied & free), diagonal(~tied)
        if not len(at):
            return P, D
        f = np.sqrt(np.maximum(area / (area.max() or 1.0), LITTLE_AREA))
        pick = csr_matrix((np.ones(len(at)), (at, np.arange(len(at)))), (len(tied), len(at)))
        blocks = determined(moves.reshape(len(tied), -1)[at], f[at // self.sides.gdim])
        return tuple(a + pick @ csr_matrix(b) @ pick.T for a, b in zip((P, D), blocks))


def spins(turn: Array) -> Array:
    """T (1, 1), (3, 3): by which rotation a change of a rotation vector turns what is turned.

    >>> spins(np.array([0.0, 0.0, np.pi])).round(6)
    array([[ 0.     , -0.63662,  0.     ],
           [ 0.63662,  0.     ,  0.     ],
           [ 0.     ,  0.     ,  1.     ]])
    """
    if len(turn) == 1:
        return np.eye(1)
    K = np.cross(np.eye(3), turn)  # K a = turn × a
    a = float(np.linalg.norm(turn))
    series = 1.0 / 6.0 - a**2 / 120.0 + a**4 / 5040.0
    third = series if a < SERIES_BELOW else (a - np.sin(a)) / a**3
    return np.asarray(np.eye(3) + 0.5 * np.sinc(0.5 * a / np.pi) ** 2 * K + third * K @ K)
