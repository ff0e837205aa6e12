"""Nodes that hardly any pair holds, and what they take from those that speak for them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, identity

from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.contact.friction_nodes import FrictionNodes
from dolfinx_llm.laws.speakers import follow, speakers, sums, unheld

REMEMBERED = 3  # states of contact
ADRIFT = 1e-2  # sum of N² below which a frame node is led until contact has come to rest


@dataclass(frozen=True, eq=False)
class Followers:
    """Who speaks for whom, for one state of contact."""

    speaker: np.ndarray  # (k,) the node whose law holds for each
    unheld: np.ndarray  # (k,) nodes that no force reaches
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
    def of(nodes: FrictionNodes, tied: np.ndarray, active: np.ndarray, adrift: float) -> Followers:
        """Nodes at the rim of contact follow a neighbour.

        Args:
            nodes: of the interface.
            tied: (n,) pairs that follow the frame tangentially.
            active: (n,) pairs in contact.
            adrift: sum of N² of the pairs tied below which a node also moves with its speaker.
        """
        k, t = nodes.kappa.shape
        follows = nodes.of(tied)
        speaker = speakers(follows, nodes.of(active | tied))
        if np.array_equal(speaker, np.arange(k)):
            return replace(Followers.none(nodes), unheld=unheld(follows, speaker))
        alike = follow(speaker, nodes.tangents)
        weak = np.repeat(speaker != np.arange(k), t).astype(float)
        relative = identity(k * t, format="csr") - diagonal(weak) @ alike
        held = sum(np.asarray(N.power(2).sum(axis=0)).ravel() for N in follows)
        leader = np.where(held < adrift, speaker, np.arange(k))
        carried = _carried(leader, nodes.geometry.directions)
        return Followers(speaker, unheld(follows, speaker), alike.T.tocsr(), relative, *carried)

    @cached_property
    def sums(self) -> csr_matrix:
        """(k, k) sums over the nodes for which a node speaks."""
        return sums(self.speaker)

    def share(self, friction: np.ndarray, bears: np.ndarray, tangents: np.ndarray) -> np.ndarray:
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

    def of(self, tied: np.ndarray, active: np.ndarray, adrift: float) -> Followers:
        """As of ``Followers.of``."""
        key = np.append([tied, active], adrift).tobytes()
        found = self._known.pop(key, None) or Followers.of(self._nodes, tied, active, adrift)
        self._known = dict([*self._known.items(), (key, found)][-REMEMBERED:])
        return found


def _carried(leader: np.ndarray, directions: np.ndarray) -> tuple[csr_matrix, csr_matrix]:
    """Frame nodes that hardly any pair holds move tangentially as their leader (m,) does: sums of
    forces at the leaders, and tangential motion against theirs (m d, m d)."""
    m, d = directions.shape[:2]
    weak = np.repeat(leader != np.arange(m), d)
    weak[d - 1 :: d] = False
    follows = diagonal(weak)
    moved = follows @ follow(leader, directions)
    return (diagonal(~weak) + moved.T).tocsr(), follows - moved
