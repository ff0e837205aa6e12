"""Rigid obstacles under a prescribed force: their displacement is found.

Contact knows nodes relative to the obstacle alone: a displacement s of it is one of all nodes by
-s. With S that motion of the nodes, f(z, q) the forces on them and F that on the obstacle,

    Sᵀ f + F = 0,   d/ds = (d/dz) S.

Obstacles that bodies are tied to turn under a moment as well: see ``tied_obstacle``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import block_diag, bmat, csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.sparse import diagonal, per_item
from dolfinx_llm.finite.obstacles.obstacle_contact import (
    ObstacleContact,
    ObstacleFriction,
    ObstaclePlace,
)
from dolfinx_llm.finite.pairs.terms import ContactTerms, Held, yields
from dolfinx_llm.interface.against import RESISTED, check_resisted
from dolfinx_llm.interface.obstacles import RigidPlane
from dolfinx_llm.laws.rows import CLOSED, OPEN, STICK

BARELY = 1e-9  # cosine beyond that of the cone of friction that is rounding
FALLS = 1e-9  # over the stiffness: by which an obstacle in contact yields to a force, at most


@dataclass(frozen=True, eq=False)
class Pressed(ObstacleContact):
    """Unknowns: those of an obstacle that is moved, then s, per component with a force.

    Put before a contact with an obstacle in the list of bases.
    """

    @property
    def axes(self) -> Array:
        """(f,) components with a force or moment."""
        return np.flatnonzero(self.forced)

    @property
    def units(self) -> Array:
        """(f,) displacement or angle of each motion of length 1 [1, rad / length]."""
        surface = self.sides.surfaces[0]
        return np.where(self.axes < self.sides.gdim, 1.0, 1.0 / surface.diameter)

    @property
    def size(self) -> int:
        return super().size + len(self.axes)

    @property
    def owner(self) -> Array:
        return np.concatenate([super().owner, 0 * self.axes])

    def placing(self, pose: Array | None, q: Array) -> Array:
        """A pose that is held, with the displacement found."""
        found = (self.pose() if pose is None else pose).copy()
        found[self.sides.gdim + self.axes] += self.units * q[len(q) - len(self.axes) :]
        return found

    def touching(
        self, place: ObstaclePlace, q: Array, before: Array, held: Held, reach: Array
    ) -> tuple[Array, Held]:
        """(n,) status of the pairs, and what is held; q may have moved on from the place."""
        place = replace(place, pose=self.posed(self.placing(held.pose, q)))
        if held.pose_before is not None:
            held = replace(held, pose_before=self.placing(held.pose_before, q))
        return super().touching(place, q[: super().size], before, held, reach)

    def nearing(self, place: ObstaclePlace, dz: Array, dq: Array) -> Array:
        s = np.zeros(len(self.forced))
        s[self.axes] = self.units * dq[len(dq) - len(self.axes) :]
        nearer = self.sides.control @ (place.by_x @ s[: self.sides.gdim])
        return super().nearing(place, dz, dq) - nearer

    def terms(
        self, place: ObstaclePlace, q: Array, status: Array, held: Held, free: Array
    ) -> ContactTerms:
        """All that Newton's iteration asks for; arguments as for an obstacle that is moved."""
        n, gdim = place.normal.shape
        k, c = super().size, held.scale
        if held.about is not None:
            dz, s = held.about[0].reshape(n, gdim).copy(), held.about[1][k:] - q[k:]
            dz[:, self.axes] -= s
            held = replace(held, about=(dz.ravel(), held.about[1][:k]))
        moves = free | np.isin(np.arange(len(free)) % gdim, self.axes)  # against the obstacle
        t = super().terms(place, q[:k], status, held, moves)
        at = np.arange(len(free)).reshape(n, gdim)[:, self.axes]
        S = csr_matrix(
            (np.full(at.size, -1.0), (at.ravel(), np.tile(np.arange(len(self.axes)), n))),
            (len(free), len(self.axes)),
        )
        force = self.pressing(held)
        self._resists(place, status, force)
        rest = (S.T @ t.force + force) / c
        alone = 1.0 if not (status != OPEN).any() else FALLS
        own = [
            [t.own + self._supported(place, status, held, free, k), t.left @ S],
            [-S.T @ t.top / c, -S.T @ t.K @ S / c - diagonal(np.full(len(force), alone))],
        ]
        return replace(
            t,
            top=bmat([[t.top, t.K @ S]], format="csr"),
            left=bmat([[t.left], [-S.T @ t.K / c]], format="csr"),
            own=bmat(own, format="csr"),
            rest=np.concatenate([t.rest, rest]),
            miss=max(t.miss, float(np.abs(rest).max()) * c),
        )

    def pressing(self, held: Held) -> Array:
        """(f,) forces on the motions [force]."""
        pose = self.pose() if held.pose is None else held.pose
        return self.units * pose[-len(self.forced) :][self.axes]

    def _supported(
        self, place: ObstaclePlace, status: Array, held: Held, free: Array, k: int
    ) -> csr_matrix:
        """(k, k) by how much rows of nodes that supports hold yield: there are more of them than
        displacements of the obstacle."""
        n, gdim = place.normal.shape
        free = free.reshape(n, gdim)
        parts = [diagonal(yields(place.normal[:, None], free, held).ravel() * (status != OPEN))]
        if k > n:
            P = np.eye(gdim) - place.normal[:, :, None] * place.normal[:, None, :]
            parts.append(per_item(yields(P, free, held) * -1.0 * (status == STICK)[:, None, None]))
        return block_diag(parts)

    @property
    def leans(self) -> float:
        """Tangent of the largest angle between a node's force and the normal; inf: any."""
        return 0.0

    def check_pressed(self, place: ObstaclePlace, pose: Array) -> None:
        """Require a force on a plane, whose normal is the same everywhere, that contact can take.

        Raises:
            ContactError: it pulls the plane off, or along it by more than friction bears.
        """
        force, bounded = pose[-len(self.forced) :][self.axes], np.isfinite(self.leans)
        if not (bounded and isinstance(self.obstacle, RigidPlane) and force.any()):
            return
        normal = place.normal[0][self.axes]
        along = float(normal @ force / np.linalg.norm(force))
        # Of all forces with these components that which is nearest to the normal.
        beside = max(0.0, 1.0 - float(normal @ normal))
        nearest = np.hypot(np.sqrt(beside), max(along, 0.0))
        if nearest < (1.0 - BARELY) / np.hypot(1.0, self.leans):
            raise ContactError(
                f"contact does not balance the force on the {type(self.obstacle).__name__}, "
                f"{force.tolist()} along components {self.axes.tolist()}: it is pulled off, or "
                "slides without end. Give None where its displacement is to be prescribed, or "
                "change the force"
            )

    def _resists(self, place: ObstaclePlace, status: Array, force: Array) -> None:
        """Require contact that can resist the force (f,) on the obstacle."""
        closed = status == CLOSED
        if not closed.any():  # friction resists as well
            return
        bent = place.turned[closed][:, :, self.axes]
        bent = bent / max(np.abs(bent).max(), RESISTED / self.sides.surfaces[0].diameter)
        felt = np.concatenate([place.normal[closed][:, self.axes], bent.reshape(-1, len(force))])
        size, vectors = np.linalg.eigh(felt.T @ felt)
        free = vectors[:, size <= RESISTED**2 * size[-1]]
        left = free @ (free.T @ force)
        check_resisted(left, force, self.obstacle, after=f", components {self.axes.tolist()}")


@dataclass(frozen=True, eq=False)
class PressedFriction(Pressed, ObstacleFriction):
    """With friction, which resists forces along the obstacle."""

    @property
    def leans(self) -> float:
        return np.inf if self.cohesion.any() else float(self.mu.max(initial=0.0))
