"""What an interface adds to Newton's system."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import per_component
from dolfinx_llm.finite.frame.overhang import Overhang
from dolfinx_llm.laws.rows import CLOSED, OPEN, STICK

FAST = 1e-9  # part of a row at free dofs, below which supports hold the pair
YIELDS = 1e-6  # over the stiffness: by which a row yields to its force where supports hold the node
SHARED_YIELDS = 1e-1, 1e-4  # of stick at nodes of several interfaces, until pairs stand, and then


@dataclass(frozen=True, eq=False)
class Origin:
    """From where slip counts in an increment."""

    points: Any  # (n, ...) what nodes touched then: rows on a frame, points of an obstacle as drawn
    gap: Array  # (n,) at the start of the increment; inf where there was none [length]
    touched: Array  # (n,) pairs that have been in contact since
    drags: bool = False  # forces depend on it
    first: Any = None  # ``points`` at the start of the increment; None: not known


def _none() -> Array:
    return np.zeros(0, dtype=bool)


@dataclass(frozen=True, eq=False)
class Held:
    """What is chosen at the start of an increment.

    Facets and pairs may join during it. Nodes that an equilibrium has beyond the frame's edge
    leave, once each: at the frame's ends they would go in and out for ever.
    """

    candidates: Array = field(default_factory=_none)  # (f,) the moving side's facets that can touch
    pairs: Array = field(default_factory=_none)  # (n,) its nodes that take part
    chart: Array = field(default_factory=_none)  # (m, c) functions that it leaves to the frame
    left: Array = field(default_factory=_none)  # (n,) nodes that have left the frame since then
    lagged: bool = False  # rows and areas count as if nothing slid: see ``Increment``
    near: bool = False  # whether the last iterate was near the solution
    exact: bool = False  # whether slip has its exact derivative: see ``friction_law``
    origin: Origin | None = None  # of slip; None: tied
    kept: Any = None  # what an own law has kept from the last increment
    pose: Array | None = None  # what places and presses a rigid obstacle: see ``Pose``
    pose_before: Array | None = None  # the same at the start of the increment
    scale: float = 1.0  # stiffness of the bodies, which weighs lengths [force / length]
    about: Any = None  # changes (width,) and own unknowns where friction is linearised; None: here
    shared: Array = field(default_factory=_none)  # (n,) moving nodes of other interfaces as well


@dataclass(frozen=True, eq=False)
class Place:
    """How the pairs of an interface stand in one configuration, whatever they carry."""

    z: Array  # (width,) coordinates [length]
    gap: Array  # (n,) of the moving side's pairs; inf where there is none [length]
    normal: Array  # (n, gdim) out of the frame
    N: csr_matrix  # (n, m) rows
    areas: tuple[Array, Array]  # (n,), (m,) of pairs, and of the frame's nodes [area]
    overhang: Overhang | None = field(default=None, kw_only=True)  # by which pairs follow from
    # control values, of which rows and areas are; None: they are theirs

    def at_pairs(self, values: csr_matrix, gdim: int) -> csr_matrix:
        """(n gdim, c) of pairs, of the same at control values."""
        return values if self.overhang is None else per_component(self.overhang.S, gdim) @ values

    @property
    def pairs(self) -> Array:
        """(n,) which nodes of the moving side can touch."""
        return np.isfinite(self.gap)


@dataclass(frozen=True, eq=False)
class ContactTerms:
    """An interface's part of Newton's system, for coordinates z and its own unknowns q."""

    force: Array  # (width,) on the coordinates [force]
    K: csr_matrix  # (width, width) minus its derivative by z
    top: csr_matrix  # (width, q) minus its derivative by q
    left: csr_matrix  # (q, width) derivative of the interface's own equations by z
    own: csr_matrix  # (q, q) the same by q
    rest: Array  # (q,) their residual
    place: Place
    delta: float  # largest correction of a row
    status: Array  # (n,) of the pairs: 0 open, 1 stick, 2 slip, 3 closed without friction
    friction: Array | None  # (width,) part of the force; None: all that is not normal
    kept: Any = None  # () -> what an own law keeps if this is the end of the increment
    miss: float = 0.0  # largest distance of forces from the law where pairs slip [force]

    def by_whole(self, made: csr_matrix | None) -> ContactTerms:
        """The same by the coordinates (k,) of whole facets, of which ``made`` (width, k) makes all;
        None: they are these."""
        if made is None:
            return self
        K, top, left = made.T @ self.K @ made, made.T @ self.top, self.left @ made
        return replace(self, force=made.T @ self.force, K=K.tocsr(), top=top.tocsr(), left=left)


class MovingContact:
    """An interface with a law, at finite deformation.

    Where nothing else is said pairs close and open by themselves: the first (n,) of the unknowns q
    are their normal forces lambda [force].
    """

    parts: ClassVar[bool] = True  # pairs may part
    settles: ClassVar[bool] = True  # nothing but lambda and gaps decides which pairs are closed
    pressed: ClassVar[tuple[int, ...]] = (CLOSED,)  # status of pairs that stay closed in a step in
    # time if they press at its start, and, the last, what they are where they would open

    sides: Any  # its surfaces: ``Sides``, or ``OneSide``

    @property
    def named(self) -> str:
        """What touches."""
        return " and ".join(surface.name for surface in self.sides.surfaces)

    @property
    def overlaps(self) -> bool:
        """Whether surfaces may overlap under its forces."""
        return False

    def reading(self, given: dict[str, Array]) -> MovingContact:
        """The same with what its law has read at the start of a load step, see ``Law.begin_step``.

        Args:
            given: (n, ...) at the moving side's nodes.
        """
        return self

    def staying(self, stays: Array, now: Array) -> Array:
        """(n,) status of pairs, with those (n,) that stay in contact."""
        return np.where(stays & (now == OPEN), self.pressed[-1], now)

    @property
    def size(self) -> int:
        """Number of own unknowns q."""
        raise NotImplementedError

    @property
    def owner(self) -> Array:
        """(size,) ranks that own the unknowns."""
        raise NotImplementedError

    def carried(self, q: Array, R: Array) -> Array:
        """Own unknowns q where all turns by R (gdim, gdim)."""
        return q

    def hold(self, z: Array) -> Held:
        """What is chosen at coordinates z for an increment that starts there: nothing without a
        frame that moves."""
        return Held()

    def missed(self, place: Any, held: Held) -> Held | None:
        """What is held where the equilibrium there asks for other pairs; None: it does not."""
        return None

    def place(self, z: Array, q: Array, held: Held) -> Any:
        """How the pairs stand at coordinates z and own unknowns q: a ``Place`` of its own kind."""
        raise NotImplementedError

    def touching(
        self, place: Any, q: Array, before: Array, held: Held, reach: Array
    ) -> tuple[Array, Held]:
        """(n,) status of the pairs, and what is held from now on: closed where lambda - scale gap
        > 0.

        Args:
            place: in this configuration.
            q: own unknowns.
            before: (n,) status in the last iterate.
            held: from the start of the step.
            reach: (n,) pairs closer than that touch [length].
        """
        gap = np.where(place.pairs, place.gap, 0.0)
        closed = place.pairs & (q[: len(gap)] / held.scale - gap > -reach)
        return np.where(closed, CLOSED, OPEN), held

    def nearing(self, place: Any, dz: Array, dq: Array) -> Array:
        """(n,) changes of the pairs' gaps for those of coordinates and own unknowns [length]."""
        raise NotImplementedError

    def terms(self, place: Any, q: Array, status: Array, held: Held, free: Array) -> ContactTerms:
        """All that Newton's iteration asks for."""
        raise NotImplementedError

    def located(self, place: Any) -> Any:
        """Where all n nodes of the moving side lie on the frame: an ``OnFrame``."""
        raise NotImplementedError

    def astray(self, place: Any, status: Array) -> Array:
        """(n,) how far closed pairs are from where the law has them: not at all, but where supports
        hold both sides, which go before rigid ends [length]."""
        return np.where((status != OPEN) & self.settles, np.abs(place.gap), 0.0)

    def slip(self, place: Any, held: Held, since: Array, earlier: Any) -> Array:
        """(n, gdim) how far pairs slide: see ``Slides``; those of ties do not [length]."""
        return np.zeros_like(place.normal)

    def written(self, place: Any, slip: Array) -> Any:
        """What keeps that for the increments to come."""
        return None


class Bound(MovingContact):
    """Pairs that stay together, whatever forces they carry; put first in the list of bases."""

    parts: ClassVar[bool] = False
    settles: ClassVar[bool] = False

    def touching(
        self, place: Any, q: Array, before: Array, held: Held, reach: Array
    ) -> tuple[Array, Held]:
        """(n,) all pairs stick."""
        return np.where(place.pairs, STICK, OPEN), held


def moved(place: Place, change: Array) -> Place:
    """The same pairs where their gaps have changed (n,) [length]."""
    return replace(place, gap=place.gap + change)


def yields(directions: Array, free: Array, held: Held) -> Array:
    """(k, r, r) by how much rows yield to changes of their forces, in the derivative alone.

    Nodes that supports hold on a free frame, more than the frame has free coordinates, make rows
    that depend on each other: their forces are not unique, and those of a solver are noise. With
    this it finds of all the nearest to the last ones, and what is left of the equations is no other
    [length / force].

    Args:
        directions: (k, r, gdim) of the rows at their nodes.
        free: (k, gdim) which components of the nodes' positions are not prescribed.
        held: with the stiffness.
    """
    supported = directions * ~free[:, None, :]
    return YIELDS / held.scale * supported @ np.swapaxes(directions, 1, 2)


def shares(nodes: Array, gdim: int, held: Held) -> Array:
    """(k, gdim, gdim) by how much stick yields, as of ``yields``, at nodes (k,) of the moving side
    that other interfaces have as well: in a corner what one holds along itself another one holds
    across, and the same row would be there twice. By more until pairs stand, since iterates may ask
    both for what differs a little [length / force].
    """
    if not len(held.shared):
        return np.zeros((len(nodes), gdim, gdim))
    part = SHARED_YIELDS[int(held.exact)] / held.scale * held.shared[nodes]
    return part[:, None, None] * np.eye(gdim)


def held_fast(A: csr_matrix, free: Array) -> Array:
    """(n,) which rows (n, width) have no part at free coordinates: supports hold them."""
    return np.sqrt(np.asarray(A.multiply(A) @ free.astype(float)).ravel()) < FAST


def slide(contact: MovingContact, terms: ContactTerms, dz: Array) -> float:
    """How far nodes in contact slide over the other side for changes dz (width,) [length]."""
    on, n = terms.status != OPEN, terms.place.normal
    jump = (contact.sides.jumps(terms.place.N) @ dz).reshape(n.shape)
    jump -= np.einsum("ni,ni->n", jump, n)[:, None] * n
    return float(np.linalg.norm(jump[on], axis=1).max(initial=0.0))
