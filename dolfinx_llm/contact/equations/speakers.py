"""Frame nodes that hardly any pair holds, and the nodes that speak for them.

At the rim of contact a frame node may be reached by the far ends of a few shape functions only.
Its slip κ is then the small misfit of the pairs divided by these small numbers, and the law of
friction, which asks for the sense of κ alone, could be met with the sense reversed. Such a node
takes the slip of a neighbour, which carries the forces of both: the remedy for cells that are cut
by a boundary, aggregation (Badia, Verdugo, Martín, CMAME 336 (2018) 533-553).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, identity, kron
from scipy.sparse.csgraph import connected_components

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, nearest, picking
from dolfinx_llm.contact.equations.friction_nodes import FrictionNodes
from dolfinx_llm.contact.equations.turning_slips import by_turns

REMEMBERED = 3  # states of contact
ADRIFT = 1e-2  # sum of N² below which a frame node is led until contact has come to rest
CROSSES = 1e-6  # the same, below which no force passes from side to side
HELD = 0.3  # least sum of N² over the pairs of each side that tells the slip of a frame node
BY_LITTLE = 0.03  # the same where ties are chosen, perhaps of contact narrower than a facet


def asked(
    sides: list[csr_matrix],
    shared: csr_matrix | None = None,
    weak: Array | None = None,
    held: float = HELD,
) -> csr_matrix:
    """(k, k) the node that each frame node asks who speaks for it, 1: itself, where pairs of both
    sides hold it, so that it speaks for itself; else a neighbour, or those that are alike in equal
    parts: neither rounding nor the order of nodes decides between them.

    Nodes that no pair reaches, and the best one of every piece of contact, speak for themselves.

    Args:
        sides: per side (n, k) shape functions of the pairs that follow the frame.
        shared: (k, k) ``_neighbours`` by all pairs in contact; by default by those that follow the
            frame.
        weak: (k,) nodes that do not speak, however firmly they are held; None: there are none.
        held: least sum of N² of each side with which a node speaks for itself.

    >>> far = csr_matrix([[1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [0.0, 0.9, 0.1]])
    >>> asked([far, far]).toarray().tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
    """
    k = sides[0].shape[1]
    support = np.full(k, np.inf)
    for N in sides:
        support = np.minimum(support, np.asarray(N.power(2).sum(axis=0)).ravel())
    if weak is not None:
        support = np.where(weak, 0.0, support)
    shared = _neighbours(sides) if shared is None else shared
    _, piece = connected_components(shared, directed=False)
    best = np.zeros(piece.max(initial=0) + 1)
    np.maximum.at(best, piece, support)
    known = support >= np.minimum(held, best[piece])
    found = diagonal(known)
    while not known.all():  # outwards, a ring of nodes at a time
        near = nearest((diagonal(~known) @ shared @ diagonal(known)).tocsr())
        reached = np.diff(near.indptr) > 0
        if not reached.any():
            break
        found, known = found + near, known | reached
    return (found + diagonal(~known)).tocsr()


def _neighbours(sides: list[csr_matrix]) -> csr_matrix:
    """(k, k) entries where nodes are reached by the same pairs, of shape functions (n, k)."""
    shared = csr_matrix((sides[0].shape[1],) * 2)
    for N in sides:
        shared = shared + abs(N).T @ abs(N)
    return shared


def speakers(asks: csr_matrix) -> csr_matrix:
    """(k, k) the part that nodes have in speaking for each, from whom they ask.

    >>> chain = csr_matrix([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    >>> speakers(chain).toarray().tolist()
    [[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]
    """
    speak = asks.diagonal() > 0.0
    while not speak[asks.indices].all():
        asks = asks @ asks
    return asks


def unheld(sides: list[csr_matrix], parts: csr_matrix) -> Array:
    """(k,) nodes that pairs of one side alone hold, or of none, as all that have their speaker.

    No force passes there, so that equilibrium leaves the law nothing to say, and the slip would be
    free: these nodes stick. One that speaks may itself be held by next to nothing, where those that
    are pulled at do not.

    Args:
        sides: as in ``asked``.
        parts: (k, k) of ``speakers``.

    >>> sides = [csr_matrix([[1.0, 0.0]]), csr_matrix([[0.99, 0.01]])]
    >>> each, second = identity(2), csr_matrix([[0, 1], [0, 1]])
    >>> unheld(sides, each).tolist(), unheld(sides, second).tolist()
    ([False, True], [False, False])
    """
    support = np.min([np.asarray(N.power(2).sum(axis=0)).ravel() for N in sides], axis=0)
    firm = parts.T @ (support >= CROSSES) > 0.0
    return np.asarray(parts @ firm <= 0.0)


@dataclass(frozen=True, eq=False)
class Followers:
    """Who speaks for whom, for one state of contact."""

    speaker: Array  # (k,) the node whose law holds for each, or the first of them
    turns: bool  # whether jumps of nodes that follow depend on which ones slip
    sums: csr_matrix  # (k, k) sums over the nodes for which a node speaks
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
        alone = np.arange(k), False, identity(k, format="csr"), np.zeros(k, dtype=bool)
        return Followers(*alone, every, every, identity(m, format="csr"), csr_matrix((m, m)))

    @staticmethod
    def of(
        nodes: FrictionNodes,
        tied: Array,
        near: Array,
        pulled: Array,
        adrift: Array,
        still: Array,
        chosen: bool,
        slips: Array,
    ) -> Followers:
        """Nodes at the rim of contact follow a neighbour.

        Args:
            nodes: of the interface.
            tied: (n,) pairs that follow the frame tangentially.
            near: (n,) pairs in contact, and those that open and close by turns.
            pulled: (k,) nodes that corrected rows pull at.
            adrift: (k,) sum of N² of the pairs tied below which a node also moves with its speaker.
            still: (m d,) motions of the frame that supports tell.
            chosen: ties are, and stay while pairs at the rim come and go: these tell no neighbours.
            slips: (k,) nodes that slip: jumps of those that do about a speaker tell a turn.
        """
        k, t = nodes.kappa.shape
        follows = nodes.of(tied)
        near, least = (np.ones_like(near), BY_LITTLE) if chosen else (near | tied, HELD)
        shared = _neighbours(nodes.of(near))
        asks = asked(follows, shared, pulled, least)
        parts = speakers(asks)
        speaker = np.asarray(parts.argmax(axis=1)).ravel()
        free = unheld(follows, parts)
        if np.array_equal(speaker, np.arange(k)):
            return replace(Followers.none(nodes), unheld=free)
        alike = kron(parts, identity(t), format="csr")  # in a plane all tangents are the same
        held = np.sum([np.asarray(N.power(2).sum(axis=0)).ravel() for N in follows], axis=0)
        turned = csr_matrix(alike.shape)
        if t == 2:
            x = np.einsum("ki,kti->kt", nodes.x, nodes.tangents)
            turned = by_turns(parts, shared, held, x)
        weak = speaker != np.arange(k)
        told = np.repeat(weak, t) & (abs(turned) @ np.repeat(~slips, t) == 0.0)
        alone = identity(k * t, format="csr") - diagonal(np.repeat(weak, t)) @ alike
        relative = alone - diagonal(told) @ turned
        carried = _carried((held < adrift) & weak, still, alike + turned, t)
        sums = parts.T.tocsr()
        turns = turned.nnz > 0
        return Followers(speaker, turns, sums, free, alike.T.tocsr(), relative, *carried)

    def share(self, friction: Array, bears: Array) -> Array:
        """(k, gdim) forces of friction, of those that speak for others divided among them all.

        Args:
            friction: (k, gdim) forces at the nodes [force].
            bears: (k,) what each bears, by which they share [force].
        """
        total = self.sums @ bears
        of_each = (self.sums @ friction) / np.where(total > 0.0, total, np.inf)[:, None]
        shared = bears[:, None] * (self.sums.T @ of_each)
        return np.where((total > 0.0)[self.speaker, None], shared, friction)


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


def _carried(led: Array, still: Array, moved: csr_matrix, t: int) -> tuple[csr_matrix, csr_matrix]:
    """Frame nodes that hardly any pair holds, ``led`` (m,), move tangentially as those that they
    follow make them, ``moved`` (m t, m t), but where supports tell, ``still`` (m d,): sums of
    forces there, and tangential motion against that one (m d, m d)."""
    m, d = len(led), t + 1
    along = (np.arange(m)[:, None] * d + np.arange(t)).ravel()
    tangential = picking(along, m * d)
    weak = np.repeat(led, d) & ~still
    weak[t::d] = False
    follows = diagonal(weak)
    moved = follows @ tangential.T @ moved @ tangential
    return (diagonal(~weak) + moved.T).tocsr(), (follows - moved).tocsr()
