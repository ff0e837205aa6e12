"""Frame nodes that hardly any pair holds, and the nodes that speak for them.

At the rim of contact a frame node may be reached by the far ends of a few shape functions only.
Its slip κ is then the small misfit of the pairs divided by these small numbers, and the law of
friction, which asks for the sense of κ alone, could be met with the sense reversed. Such a node
takes the slip of a neighbour, which carries the forces of both: the remedy for cells that are cut
by a boundary, aggregation (Badia, Verdugo, Martín, CMAME 336 (2018) 533-553).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.csgraph import connected_components

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, placed
from dolfinx_llm.contact.friction_nodes import FrictionNodes

REMEMBERED = 3  # states of contact
ADRIFT = 1e-2  # sum of N² below which a frame node is led until contact has come to rest
CROSSES = 1e-6  # the same, below which no force passes from side to side
HELD = 0.3  # least sum of N² over the pairs of each side that tells the slip of a frame node
BY_LITTLE = 0.03  # the same where ties are chosen, perhaps of contact narrower than a facet


def asked(
    sides: list[csr_matrix],
    touching: list[csr_matrix] | None = None,
    weak: Array | None = None,
    held: float = HELD,
) -> Array:
    """(k,) the node that each frame node asks who speaks for it: itself, where pairs of both sides
    hold it, so that it speaks for itself; else a neighbour.

    Nodes that no pair reaches, and the best one of every piece of contact, speak for themselves.

    Args:
        sides: per side (n, k) shape functions of the pairs that follow the frame.
        touching: the same of all pairs in contact, by which nodes are neighbours; by default those
            that follow the frame.
        weak: (k,) nodes that do not speak, however firmly they are held; None: there are none.
        held: least sum of N² of each side with which a node speaks for itself.

    >>> far = csr_matrix([[1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.0, 0.9, 0.1]])
    >>> asked([far, far]).tolist()
    [0, 1, 1]
    """
    k = sides[0].shape[1]
    shared, support = csr_matrix((k, k)), np.full(k, np.inf)
    for N in sides:
        support = np.minimum(support, np.asarray(N.power(2).sum(axis=0)).ravel())
    if weak is not None:
        support = np.where(weak, 0.0, support)
    for N in touching or sides:
        shared = shared + abs(N).T @ abs(N)
    _, piece = connected_components(shared, directed=False)
    best = np.zeros(piece.max(initial=0) + 1)
    np.maximum.at(best, piece, support)
    known = support >= np.minimum(held, best[piece])
    nearest = np.arange(k)
    while not known.all():  # outwards, a ring of nodes at a time
        ask = np.flatnonzero(~known)
        near = (shared[ask] @ diags(known.astype(float))).tocsr()
        near.eliminate_zeros()
        # Of neighbours alike but for rounding the first one, whichever side is named first.
        first = np.asarray(near.astype(np.float32).argmax(axis=1)).ravel()
        reached = np.diff(near.indptr) > 0
        if not reached.any():
            break
        ask = ask[reached]
        nearest[ask], known[ask] = first[reached], True
    return nearest


def speakers(nearest: Array) -> Array:
    """(k,) the node that speaks for each, from whom they ask.

    >>> speakers(np.array([0, 0, 1, 2])).tolist()
    [0, 0, 0, 0]
    """
    while (nearest[nearest] != nearest).any():
        nearest = nearest[nearest]
    return nearest


def unheld(sides: list[csr_matrix], speaker: Array) -> Array:
    """(k,) nodes that pairs of one side alone hold, or of none, as all that have their speaker.

    No force passes there, so that equilibrium leaves the law nothing to say, and the slip would be
    free: these nodes stick. One that speaks may itself be held by next to nothing, where those that
    are pulled at do not.

    Args:
        sides: as in ``asked``.
        speaker: (k,) of ``speakers``.

    >>> sides = [csr_matrix([[1.0, 0.0]]), csr_matrix([[0.99, 0.01]])]
    >>> unheld(sides, np.arange(2)).tolist(), unheld(sides, np.array([1, 1])).tolist()
    ([False, True], [False, False])
    """
    support = np.min([np.asarray(N.power(2).sum(axis=0)).ravel() for N in sides], axis=0)
    most = np.zeros(len(speaker))
    np.maximum.at(most, speaker, support)
    return most[speaker] < CROSSES


def sums(speaker: Array) -> csr_matrix:
    """(k, k) sums over the nodes for which a node speaks.

    Args:
        speaker: (k,) of ``speakers``.
    """
    k = len(speaker)
    return csr_matrix((np.ones(k), (speaker, np.arange(k))), (k, k))


def follow(nearest: Array, tangents: Array) -> csr_matrix:
    """(k t, k t) slip of all nodes from that of those that speak for them.

    Its transpose sums the forces up. Both are components along the nodes' own tangents.

    Args:
        nearest: (k,) of ``asked``.
        tangents: (k, t, gdim) unit tangents at the nodes.
    """
    k, t, _ = tangents.shape
    # The rotation next to this: what is passed on keeps its length on curved surfaces. From one
    # neighbour to the next: a quarter of a tube apart rounding would tell its sense.
    left, _, right = np.linalg.svd(np.einsum("kai,kbi->kab", tangents, tangents[nearest]))
    turn = left @ right
    turn[nearest == np.arange(k)] = np.eye(t)
    while (nearest[nearest] != nearest).any():
        turn, nearest = turn @ turn[nearest], nearest[nearest]
    index = np.arange(t)
    row = np.arange(k)[:, None, None] * t + index[:, None]
    return placed(turn, row, nearest[:, None, None] * t + index, (k * t, k * t))


@dataclass(frozen=True, eq=False)
class Followers:
    """Who speaks for whom, for one state of contact."""

    speaker: Array  # (k,) the node whose law holds for each
    unheld: Array  # (k,) nodes that no force reaches
    gather: csr_matrix  # (k q, k q) sums of forces at the speakers
    relative: csr_matrix  # (k q, k q) jumps; of nodes that follow others against theirs
    frame_gather: csr_matrix  # (m d, m d) forces at frame nodes, of those that no pair holds at
    # the node that they follow
    frame_relative: csr_matrix  # (m d, m d) their motion against that one's

    @staticmethod
    def none(nodes: FrictionNodes) -> Followers:
        """Each node speaks for itself."""
        k, m = len(nodes.kappa), len(nodes.v)
        every = identity(nodes.kappa.size, format="csr")
        alone = np.arange(k), np.zeros(k, dtype=bool)
        return Followers(*alone, every, every, identity(m, format="csr"), csr_matrix((m, m)))

    @staticmethod
    def of(
        nodes: FrictionNodes,
        tied: Array,
        active: Array,
        pulled: Array,
        adrift: float,
        chosen: bool,
    ) -> Followers:
        """Nodes at the rim of contact follow a neighbour.

        Args:
            nodes: of the interface.
            tied: (n,) pairs that follow the frame tangentially.
            active: (n,) pairs in contact.
            pulled: (k,) nodes that corrected rows pull at.
            adrift: sum of N² of the pairs tied below which a node also moves with its speaker.
            chosen: ties are, and stay while pairs at the rim come and go: these tell no neighbours.
        """
        k, t = nodes.kappa.shape
        follows = nodes.of(tied)
        near, least = (np.ones_like(active), BY_LITTLE) if chosen else (active | tied, HELD)
        nearest = asked(follows, nodes.of(near), pulled, least)
        speaker = speakers(nearest)
        if np.array_equal(speaker, np.arange(k)):
            return replace(Followers.none(nodes), unheld=unheld(follows, speaker))
        alike = follow(nearest, nodes.tangents)
        weak = np.repeat(speaker != np.arange(k), t).astype(float)
        relative = identity(k * t, format="csr") - diagonal(weak) @ alike
        held = sum(np.asarray(N.power(2).sum(axis=0)).ravel() for N in follows)
        led = (held < adrift) & (speaker != np.arange(k))
        carried = _carried(led, nearest, nodes.geometry.directions)
        return Followers(speaker, unheld(follows, speaker), alike.T.tocsr(), relative, *carried)

    @cached_property
    def sums(self) -> csr_matrix:
        """(k, k) sums over the nodes for which a node speaks."""
        return sums(self.speaker)

    def share(self, friction: Array, bears: Array, tangents: Array) -> Array:
        """(k, gdim) forces of friction, of those that speak for others divided among them all.

        Args:
            friction: (k, gdim) forces at the nodes [force].
            bears: (k,) what each bears, by which they share [force].
            tangents: (k, t, gdim) at the nodes.
        """
        total = (self.sums @ bears)[self.speaker]
        part = np.where(total > 0.0, bears / np.where(total > 0.0, total, 1.0), 0.0)
        own = np.einsum("ki,kai->ka", friction, tangents)
        own = (self.gather.T @ (self.gather @ own.ravel())).reshape(own.shape)
        shared = part[:, None] * np.einsum("ka,kai->ki", own, tangents)
        return np.where((total > 0.0)[:, None], shared, friction)


class LastFollowers:
    """Those of the last states of contact, to which glides and steps taken back return."""

    def __init__(self, nodes: FrictionNodes) -> None:
        self._nodes = nodes
        self._known: dict[bytes, Followers] = {}

    def of(self, *state: Any) -> Followers:
        """As of ``Followers.of``."""
        key = np.hstack(state).tobytes()
        found = self._known.pop(key, None) or Followers.of(self._nodes, *state)
        self._known = dict([*self._known.items(), (key, found)][-REMEMBERED:])
        return found


def _carried(led: Array, nearest: Array, directions: Array) -> tuple[csr_matrix, csr_matrix]:
    """Frame nodes that hardly any pair holds, ``led`` (m,), move tangentially as their speaker
    does: sums of forces there, and tangential motion against that one's (m d, m d)."""
    weak = np.repeat(led, directions.shape[1])
    weak[directions.shape[1] - 1 :: directions.shape[1]] = False
    follows = diagonal(weak)
    moved = follows @ follow(nearest, directions)
    return (diagonal(~weak) + moved.T).tocsr(), follows - moved
