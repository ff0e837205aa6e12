"""What a load step is solved of, and where it starts and ends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Protocol

import numpy as np
from petsc4py import PETSc

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import chosen, told
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.finite.linear.system import NewtonSystem, mean_diagonals
from dolfinx_llm.finite.pairs.terms import ContactTerms, Held, Place, slide
from dolfinx_llm.laws.rows import OPEN
from dolfinx_llm.operators.bare import check_stiffness
from dolfinx_llm.operators.numbering import BodyDofs

ROUNDED_FORCE = 1e-12  # over stiffness and facets, by inertia that holds bodies at the start


class Bodies(Protocol):
    """Nonlinear bodies without their contact."""

    dofs: BodyDofs
    size: float  # of the largest cell [length]
    in_time: bool  # load steps are steps in time: bodies may fly, and pairs that press at the start
    # of one stay in contact in it

    def residual(self, u: Array) -> Array:
        """This rank's residual of all dofs at u (n_local,)."""

    def tangent(self, u: Array) -> PETSc.Mat:
        """Its derivative, without conditions."""

    def inside_out(self, u: Array) -> tuple[int, list[float]]:
        """How many cells are inside out at u, and where one is drawn; collective."""


@dataclass(frozen=True, eq=False)
class Placed:
    """Contact or a follower load, and where its coordinates stand."""

    what: Any  # MovingContact or Follower
    numbers: Array  # (k,) dofs in the vector of all bodies
    drawn: Array  # (width,) coordinates as drawn [length]
    free: Array  # (width,) not prescribed
    reads: Callable[[], Any] | None = None  # ``Law.begin_step``, or a tie anew; None: nothing
    made: Any = None  # (width, k) coordinates by those of k dofs: see ``DividedSides``; None: these
    shared: Any = None  # (n,) whether the moving side's nodes carry frames of other interfaces

    def under(self, dofs: BodyDofs) -> Placed:
        """The same where other dofs are prescribed; collective."""
        free = dofs.values(self.numbers, dofs.fixed.astype(float)) == 0.0
        return replace(self, free=free if self.made is None else abs(self.made) @ free > 0.0)

    def values(self, dofs: BodyDofs, u: Array) -> Array:
        """(width,) at the coordinates, of this rank's (n_local,); collective."""
        found = dofs.values(self.numbers, u)
        return found if self.made is None else np.asarray(self.made @ found)

    def at_dofs(self, force: Array) -> Array:
        """(k,) of forces (width,) on the coordinates."""
        return force if self.made is None else np.asarray(self.made.T @ force)

    @property
    def by_surface(self) -> list[Array]:
        """Dofs of the coordinates of each surface."""
        return [part.ravel() for part in self.what.sides.split(self.known) if part.size]

    @cached_property
    def known(self) -> Array:
        """(width,) dofs by which the coordinates are known, negative where they have none."""
        if self.made is None:
            return self.numbers
        own = np.diff(self.made.indptr) == 1
        at = self.made.indices[self.made.indptr[:-1]]
        return np.where(own, self.numbers[at], -1)

    def touched(self, moving: Array, now: Array) -> Array:
        """Of dofs by which nodes of the moving side are known (n,), those of nodes in contact, by a
        status (n,), and of nodes that these go with."""
        on = (now != OPEN)[: len(moving)]
        if self.made is None:
            return moving[on]
        rows = self.what.sides.split(np.arange(len(self.drawn)))[0][on, 0]
        return self.numbers[np.unique(self.made[rows].indices)]

    @property
    def moving(self) -> Array:
        """(n,) dofs by which the moving side's nodes are known."""
        found: Array = self.what.sides.split(self.known)[0][:, 0]
        return found

    @property
    def meets(self) -> tuple[Array, Array]:
        """The same of the moving side and of the frame; neither without one."""
        if self.what.sides is None or self.what.sides.frame is None:
            return np.zeros(0), np.zeros(0)
        moving, frame = self.what.sides.split(self.known)
        return moving[:, 0], frame[:, 0]

    @property
    def led(self) -> int | None:
        """The side that supports lead as a whole, which then carries the frame; None: neither."""
        sides = self.what.sides
        return sides.frame if getattr(sides, "prescribed", False) else None

    def against(self, obstacle: Any) -> bool:
        """Whether it is contact with this rigid obstacle."""
        return getattr(self.what, "obstacle", None) is obstacle

    def begun(self) -> Placed:
        """The same at the start of a load step, with what its law reads then; collective."""
        if self.reads is None:
            return self
        return replace(self, what=self.what.reading(self.reads()))

    def at(self, dofs: BodyDofs, u: Array) -> Array:
        """(width,) coordinates at this rank's u; collective."""
        return self.drawn + self.values(dofs, u)


@dataclass(frozen=True, eq=False)
class NewtonState:
    """An equilibrium."""

    u: Array  # (n_local,) this rank's displacement [length]
    own: tuple[Array, ...]  # unknowns of each interface
    status: tuple[Array | None, ...]  # of the pairs of each interface; None: not known yet
    pressures: Array  # of the follower loads [force / area]
    poses: tuple[Array, ...]  # per interface what places a rigid obstacle; empty without one
    kept: tuple[Any, ...]  # per interface what its own law keeps; None without one
    pushed: Array  # (n_local,) forces of contact and follower loads on the bodies [force]


@dataclass(frozen=True, eq=False)
class LoadStep:
    """A load step from one state to what is prescribed now."""

    start: NewtonState
    values: Array  # (n_local,) prescribed displacements at its end [length]
    pressures: Array  # at its end [force / area]
    poses: tuple[Array, ...]  # of rigid obstacles at its end
    unbalanced: Array  # (n_local,) residual of the start under the loads of its end [force]


@dataclass(eq=False)
class Equations:
    """All that a load step is solved of."""

    bodies: Bodies  # without their contact
    interfaces: Sequence[Placed]  # in contact
    followers: Sequence[Placed]  # follower loads
    system: NewtonSystem  # of the unknowns
    size: float  # of the facets in contact [length]
    times: StageTimes  # to which seconds are added
    scale: float = 0.0  # stiffness of the bodies [force / length], see ``measure``
    scales: Sequence[float] = ()  # the same of each interface's softer surface, by which its pairs
    # come and go: inertia, or a far stiffer body, would tell gaps of rounding from contact
    springs: Array | None = None  # (n_local,) that hold this rank's dofs where an iterate has put
    # them [force / length]
    damped: bool = False  # others do in proportion to what is left of the forces, as of Levenberg
    # and Marquardt: contact that holds bodies is not known yet

    def measure(self, u: Array) -> PETSc.Mat:
        """Find the bodies' stiffness at this rank's u: moduli may have changed, or a step in time
        is part of it; their tangent there, which the first iteration takes. Collective.

        Raises:
            ContactInputError: F gives some displacements none, or bodies as drawn a negative one.
        """
        with self.times.timed("assembly of J"):
            K, dofs = self.bodies.tangent(u), self.bodies.dofs
        try:
            check_stiffness(K, dofs, "F", at_rest=not u.any())
        except ContactInputError:
            K.destroy()
            raise
        surfaces = [placed.by_surface for placed in self.interfaces]
        rows = [dofs.first + dofs.of_nodes, *(at for both in surfaces for at in both)]
        self.scale, *each = told(dofs.comm, mean_diagonals(K, rows)).tolist()
        ends = np.cumsum([0, *map(len, surfaces)])
        self.scales = [min(each[a:b]) for a, b in zip(ends[:-1], ends[1:], strict=True)]
        return K


def chosen_at(
    steps: Equations, good: NewtonState, poses: Sequence[Array]
) -> tuple[list[Held], list[Any]]:
    """What interfaces, and follower loads, hold in an increment from a state to poses of obstacles.
    It is found on rank 0: what is covered by rounding alone is so on all, or on none. Collective.
    """
    dofs, found, faces = steps.bodies.dofs, list[Any](), list[Any]()
    for placed in steps.interfaces:
        hold = partial(placed.what.hold, placed.at(dofs, good.u))
        found.append(chosen(dofs.comm, hold))
    for load in steps.followers:
        closed = touching_of(load, steps.interfaces, good.status)
        covering = partial(load.what.hold, load.at(dofs, good.u), closed)
        faces.append(chosen(dofs.comm, covering))
    held = [
        replace(own, pose=pose, pose_before=before, kept=kept, scale=scale)
        for own, pose, before, kept, scale in zip(
            found, poses, good.poses, good.kept, steps.scales, strict=True
        )
    ]
    return held, faces


def touching_of(load: Placed, interfaces: Sequence[Placed], status: Sequence[Any]) -> Array:
    """(n,) which nodes of a follower load's moving side, or of one that an obstacle may cover, are
    in contact, by the status of the pairs of each interface; all of one of which it is not known
    yet."""
    closed, obstacle = [np.zeros(0)], load.what.obstacle
    for placed, now in zip(interfaces, status, strict=True):
        if obstacle is None or placed.against(obstacle):
            moving = placed.meets[0] if obstacle is None else placed.moving
            closed.append(moving if now is None else placed.touched(moving, now))
    n, gdim = load.what.surfaces[0].x.shape
    nodes = load.meets[0] if obstacle is None else load.numbers[: n * gdim : gdim]
    return np.isin(nodes, np.concatenate(closed))


def missed_at(
    steps: Equations,
    u: Array,
    places: Sequence[Place],
    status: Sequence[Array],
    held: list[Held],
    faces: list[Any],
) -> bool:
    """Whether something else than what is held touches, or covers, at an equilibrium u (n_local,)
    with a status of pairs, which is held from now on: ``held`` and ``faces`` are changed. As of
    ``chosen_at``."""
    dofs, found = steps.bodies.dofs, False
    for i, (placed, place) in enumerate(zip(steps.interfaces, places, strict=True)):
        own = replace(held[i], kept=None)
        if (now := chosen(dofs.comm, partial(placed.what.missed, place, own))) is not None:
            found, held[i] = True, replace(now, kept=held[i].kept)
    for i, load in enumerate(steps.followers):
        closed = touching_of(load, steps.interfaces, status)
        covering = partial(load.what.missed, load.at(dofs, u), closed, faces[i])
        if (over := chosen(dofs.comm, covering)) is not None:
            found, faces[i] = True, over
    return found


def with_shared(
    interfaces: Sequence[Placed], held: Sequence[Held], status: Sequence[Array]
) -> list[Held]:
    """Per interface what is held, with whether others have the moving side's nodes as well: on
    their frames, or in contact, by status (n,)."""
    closed = [np.zeros(0), *(p.moving[s != OPEN] for p, s in zip(interfaces, status, strict=True))]
    found, count = np.unique(np.concatenate(closed), return_counts=True)
    twice = found[(count > 1) & (found >= 0)]
    shared = [p.shared | np.isin(p.moving, twice) for p in interfaces]
    return [replace(h, shared=s) for h, s in zip(held, shared, strict=True)]


def stays(steps: Equations, start: NewtonState) -> list[Any]:
    """Per interface the pairs that stay in contact in a step in time: those that press at its
    start by more than rounding; (n,) or one for all."""
    presses = ROUNDED_FORCE * steps.scale * steps.size
    return [
        steps.bodies.in_time
        and placed.what.parts
        and status is not None
        and np.isin(status, placed.what.pressed) & (q[: len(status)] > presses)
        for placed, status, q in zip(steps.interfaces, start.status, start.own, strict=True)
    ]


def slid(steps: Equations, terms: list[ContactTerms], du: Array) -> float:
    """How far nodes in contact slide over the other side for a change of u [length]."""
    every, dofs = zip(steps.interfaces, terms, strict=True), steps.bodies.dofs
    return max((slide(p.what, t, p.values(dofs, du)) for p, t in every), default=0.0)
