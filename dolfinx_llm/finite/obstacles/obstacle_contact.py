"""Contact with a rigid obstacle at finite deformation: no frame, no design.

Every node p has its own point of the obstacle. With n out of the obstacle there and lambda_p the
force that p carries,

    force on p: lambda_p n,   gap_p = clearance(x_p) >= 0,   lambda >= 0,   their product 0,

so that any pressure passes as the nodes' forces of it; of second-order bodies gaps and forces are
those of control values, see ``sides``. The obstacle is asked where it is drawn: x
is moved back, n moved on, by its displacement and the finite rotation about its pivot.

With friction it drags along what it moves and turns: what node p touched at the start is a point of
the obstacle as drawn, X⁰_p, now carried to pivot + shift + R (X⁰_p - pivot). There is no slip where
body and obstacle move as one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, per_component, per_item
from dolfinx_llm.design.rises import rises
from dolfinx_llm.finite.frame.areas import everything, surface_integrals
from dolfinx_llm.finite.frame.jacobians import coordinates, jacobian
from dolfinx_llm.finite.obstacles.pose import Pose
from dolfinx_llm.finite.pairs.friction import Friction
from dolfinx_llm.finite.pairs.slides import MET_AT, Slides
from dolfinx_llm.finite.pairs.terms import ContactTerms, Held, Origin, Place, held_fast
from dolfinx_llm.geometry.cells import facet_vectors
from dolfinx_llm.geometry.pairs import control_matrices
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.against import checked_clearance, forces_on, loaded
from dolfinx_llm.interface.obstacle import Obstacle
from dolfinx_llm.laws.rows import OPEN

DIFFERENCE = 1e-5  # over the surface's size: of points between which clearances are compared
KINK = 0.05  # change of the direction between them that is an edge of the obstacle
TURNED_AWAY = -0.5  # cosine between a node's normal and the way into the obstacle: it faces away


@dataclass(frozen=True, eq=False)
class OneSide:
    """A surface that touches no other one; its coordinates are all there are."""

    surfaces: tuple[Surface]
    moving: int = 0
    frame: None = None
    first: tuple[int, int] = (0, 0)  # number of the nodes' first coordinate, and of no frame's
    within: float = np.inf  # gap over a facet's size from which on nothing is looked for

    @property
    def gdim(self) -> int:
        """Dimension of space."""
        return int(self.surfaces[0].x.shape[1])

    @property
    def mover(self) -> Surface:
        """The surface."""
        return self.surfaces[0]

    def split(self, z: Array) -> tuple[Array, Array]:
        """Positions (n, gdim) of the nodes, and those of no frame."""
        return z.reshape(-1, self.gdim), np.zeros((0, self.gdim))

    def moves(self, free: Array) -> Array:
        """(n, gdim) components in which nodes are free."""
        return self.split(free)[0]

    @cached_property
    def control(self) -> csr_matrix:
        """C (n, n): see ``sides``."""
        return control_matrices(self.surfaces[0])[1]

    @cached_property
    def nodal(self) -> csr_matrix:
        """E (n, n)."""
        return control_matrices(self.surfaces[0])[0]

    def jumps(self, N: csr_matrix) -> csr_matrix:
        """(n gdim, n gdim) motion of the pairs against what stands still."""
        return self._jumps

    @cached_property
    def _jumps(self) -> csr_matrix:
        return per_component(self.control, self.gdim)


@dataclass(frozen=True, eq=False)
class ObstaclePlace(Place):
    """Nodes beside an obstacle, with derivatives by their own positions."""

    by_x: Array  # (n, gdim) of the nodes' gaps
    turned: Array  # (n, gdim, gdim) of the normal [1 / length]
    pose: Pose


@dataclass(frozen=True, eq=False)
class ObstacleContact(Slides):
    """Unknowns: a force per node. Points of the obstacle are written as drawn, (n, gdim)."""

    sides: OneSide
    obstacle: Obstacle
    forced: tuple[bool, ...]  # which components of force and moment on it are prescribed

    @classmethod
    def of(cls, surface: Surface, obstacle: Obstacle, *friction: Array) -> ObstacleContact:
        """Contact of a surface, as drawn.

        Args:
            surface, obstacle: what touches.
            friction: coefficients and cohesion, of a class with friction.

        Raises:
            ContactInputError: what places the obstacle does not fit.
        """
        return cls(OneSide((surface,)), obstacle, loaded(obstacle, surface.x.shape[1]), *friction)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return len(self.sides.surfaces[0].x)

    @property
    def owner(self) -> Array:
        return self.sides.surfaces[0].owner

    @property
    def named(self) -> str:
        return f"{super().named} and {type(self.obstacle).__name__}"

    @cached_property
    def rise(self) -> Array:
        """(n,) ``rises`` of the surface [length]."""
        return rises(self.sides.surfaces[0])

    def pose(self) -> Array:
        """Pivot, displacement, rotation, force and moment as they are now; none is 0.

        Raises:
            ContactInputError: they do not fit, or a force is prescribed for other components.
        """
        gdim = self.sides.gdim
        shift, turn, pivot, *_ = self.obstacle.pose(gdim)
        return np.array([*pivot, *shift, *turn, *forces_on(self.obstacle, self.forced, gdim)])

    def led(self, pose: Array) -> tuple[Array, Array] | None:
        """Which coordinates (width,) an obstacle with this pose leads, and where to; None: it lets
        them go, or yields."""
        return None

    def touching(
        self,
        place: ObstaclePlace,
        q: Array,
        before: Array,
        held: Held,
        reach: Array,
    ) -> tuple[Array, Held]:
        """(n,) status of the pairs, and what is held; at first those touch as well that did so
        before the obstacle moved: nodes have not followed it yet."""
        if held.pose_before is not None:
            origin = held.origin or self.started(place, held, before != OPEN)
            X = self.posed(held.pose_before).back(self.sides.split(place.z)[0])
            came = self.sides.control @ self._clearance(X)
            gap = np.where(place.pairs, np.minimum(came, place.gap), np.inf)
            place, held = replace(place, gap=gap), replace(held, pose_before=None, origin=origin)
        return super().touching(place, q, before, held, reach)

    def place(self, z: Array, q: Array, held: Held) -> ObstaclePlace:
        """Gaps and directions with their derivatives, by central differences of the clearance.

        Args:
            z: (width,) coordinates [length].
            q: own unknowns.
            held: with the pose of the obstacle.
        """
        surface, gdim = self.sides.surfaces[0], self.sides.gdim
        x, _ = self.sides.split(z)
        h = DIFFERENCE * surface.diameter
        steps = h * np.concatenate([np.zeros((1, gdim)), np.eye(gdim), -np.eye(gdim)])
        points = (x + steps[:, None]).reshape(-1, gdim)
        pose = self.posed(self.placing(held.pose, q))
        gaps, into = checked_clearance(self.obstacle, pose.back(points))
        normals = -into @ pose.R.T
        gaps, normals = gaps.reshape(-1, len(x)) - self.rise, normals.reshape(-1, len(x), gdim)
        with np.errstate(invalid="ignore"):
            by_x = (gaps[1 : gdim + 1] - gaps[gdim + 1 :]).T / (2.0 * h)
        turned = np.moveaxis(normals[1 : gdim + 1] - normals[gdim + 1 :], 0, 2)  # (n, i, k)
        smooth = np.isfinite(by_x).all(axis=1) & (np.abs(turned).max(axis=(1, 2)) < KINK)
        vectors = self.vectors(x, surface.cells)
        areas = np.linalg.norm(vectors, axis=1)
        away = np.einsum("ni,ni->n", vectors, -normals[0]) < TURNED_AWAY * areas
        return ObstaclePlace(
            z=z,
            gap=np.where(
                abs(self.sides.control) @ away > 0.0, np.inf, self.sides.control @ gaps[0]
            ),
            normal=normals[0],
            N=csr_matrix((len(x), 0)),
            areas=(areas, np.zeros(0)),
            by_x=np.where(smooth[:, None], by_x, normals[0]),
            turned=np.where(smooth[:, None, None], turned / (2.0 * h), 0.0),
            pose=pose,
        )

    def vectors(self, x: Array, cells: Array) -> Array:
        """(n, gdim) vector areas at control values, of facets with nodes ``cells`` (f, k) of nodes
        at x (n, gdim) [area]."""
        found, surface = np.zeros_like(x), self.sides.surfaces[0]
        straight, thickness = surface.straightened(x), surface.thickness_at(x)
        np.add.at(found, cells, facet_vectors(straight, cells, thickness))
        return np.asarray(self.sides.nodal.T @ found)

    def _clearance(self, X: Array) -> Array:
        """(n,) of the surface with its nodes at X (n, gdim), as the obstacle was drawn [length]."""
        return checked_clearance(self.obstacle, X)[0] - self.rise

    def placing(self, pose: Array | None, q: Array) -> Array:
        """A pose that is held, or as it is now, with what own unknowns say of it."""
        return self.pose() if pose is None else pose

    def posed(self, pose: Array | None) -> Pose:
        """A pose that is held; None: as it is now."""
        return Pose.of(self.pose() if pose is None else pose, self.sides.gdim)

    def started(self, place: ObstaclePlace, held: Held, closed: Array) -> Origin:
        """Where slip counts from: the obstacle stands where the increment starts."""
        surface = self.sides.surfaces[0]
        X = self.posed(held.pose_before).back(self.sides.split(place.z)[0])
        gap = self.sides.control @ self._clearance(X)
        gap[gap < MET_AT * surface.facet_size] = 0.0
        return Origin(points := self.sides.control @ X, gap, closed, first=points)

    def here(self, place: ObstaclePlace) -> Array:
        """(n, gdim) where the nodes' places were drawn [length]."""
        return self.sides.control @ place.pose.back(self.sides.split(place.z)[0])

    def way(self, place: ObstaclePlace, origin: Origin) -> tuple[Array, csr_matrix]:
        x = self.sides.control @ self.sides.split(place.z)[0]
        way = x - place.pose.on(origin.points)
        return way, self.sides.jumps(place.N)

    def written(self, place: ObstaclePlace, slip: Array) -> Array:
        """(n, gdim) as the obstacle was drawn."""
        return slip @ place.pose.R

    def read(self, place: ObstaclePlace, written: Array) -> Array:
        return written @ place.pose.R.T

    def nearing(self, place: ObstaclePlace, dz: Array, dq: Array) -> Array:
        return np.asarray(self._gap_by(place) @ dz)

    def _gap_by(self, place: ObstaclePlace) -> csr_matrix:
        """(n, width) derivatives of the gaps by the coordinates."""
        own = coordinates(np.arange(len(place.gap))[:, None], self.sides.gdim)
        return self.sides.control @ jacobian(place.by_x[:, None], own, own.size)

    def terms(
        self, place: ObstaclePlace, q: Array, status: Array, held: Held, free: Array
    ) -> ContactTerms:
        """All that Newton's iteration asks for; arguments as of ``NormalContact.terms``."""
        n, gdim = place.normal.shape
        width, own = n * gdim, coordinates(np.arange(n)[:, None], gdim)
        C = self.sides.control
        A = C @ jacobian(place.normal[:, None], own, width)
        closed = (status != OPEN) & ~held_fast(A, free)
        on = diagonal(closed)
        force = np.where(status != OPEN, q[:n], 0.0)
        return ContactTerms(
            force=A.T @ force,
            K=per_item(-(C.T @ force)[:, None, None] * place.turned),
            top=-(on @ A).T.tocsr(),
            left=on @ self._gap_by(place),
            own=diagonal(~closed / held.scale),
            rest=np.where(closed, place.gap, q[:n] / held.scale),
            place=place,
            delta=0.0,
            status=status,
            friction=np.zeros(width),
        )


@dataclass(frozen=True, eq=False)
class ObstacleFriction(Friction, ObstacleContact):
    """With friction."""

    def turned(self, place: ObstaclePlace, nodes: Array) -> csr_matrix:
        own = coordinates(nodes[:, None], self.sides.gdim)
        return jacobian(place.turned[nodes], own, len(place.z))

    def growth(self, place: ObstaclePlace, nodes: Array) -> csr_matrix:
        x, surface = self.sides.split(place.z)[0], self.sides.surfaces[0]
        area, by_x = surface_integrals(x, surface, everything(x, surface, 0, x.size), 0)
        unit = area / np.maximum(np.linalg.norm(area, axis=1), 1e-300)[:, None]
        return (per_item(unit[:, None]) @ by_x)[nodes]
