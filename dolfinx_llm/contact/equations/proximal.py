"""Rows of the frames, and the proximal term.

It holds frame nodes and slips where contact leaves them free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.sparse import block_diag, coo_matrix, csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import beside, picking
from dolfinx_llm.contact.equations.at_supports import holding
from dolfinx_llm.contact.equations.state import InterfaceState


def proximal_term(states: Sequence[InterfaceState], m: int, stiffness: float) -> csr_matrix:
    """(m, m) matrix of the proximal term -ε c (w - w_c).

    With friction each side's own field, v + κ and v - κ, is held as firmly as its pairs are.

    Args:
        states: of the interfaces.
        m: number of unknowns w.
        stiffness: ε c [force / length].
    """
    row, col, value = [np.empty(0, dtype=int)], [np.empty(0, dtype=int)], [np.empty(0)]

    def add(i: Array, j: Array, x: Any) -> None:
        row.append(i)
        col.append(j)
        value.append(-stiffness * x)

    for s in states:
        if not s.law.opens:
            continue
        nodes, tied, every = s.nodes, s.support(tied=True), s.support(tied=False)
        v = nodes.v.reshape(-1, max(nodes.geometry.directions.shape[1], 1))
        kappa = nodes.kappa if nodes.kappa.size else nodes.kappa[:, :0]
        if nodes.geometry.rigid:
            add(nodes.v, nodes.v, np.full(len(nodes.v), float(len(nodes.rows))))
        elif nodes.geometry.law_side is not None:
            for along in v.T:
                add(along, along, nodes.frame_support)
        else:
            add(v[:, -1], v[:, -1], sum(every))
            for i in range(v.shape[1] - 1):
                add(v[:, i], v[:, i], sum(tied))
        at = range(v.shape[1])[s.law.components_of_jumps(v.shape[1])]
        for i, jump in enumerate(kappa.T):
            held = every if s.law.gives and i == kappa.shape[1] - 1 else tied
            if nodes.geometry.law_side is None:
                add(v[:, at[i]], jump, held[0] - held[1])
                add(jump, v[:, at[i]], held[0] - held[1])
            add(jump, jump, sum(held))
    index = np.concatenate(row), np.concatenate(col)
    return coo_matrix((np.concatenate(value), index), (m, m)).tocsr()


@dataclass(frozen=True, eq=False)
class SlipRows:
    """What rows of an interface's law multiply, k q of them and k, for one state of contact."""

    T: csr_matrix  # (k q, n) tangential forces of λ, summed up where nodes speak for others
    N: csr_matrix  # (k, n) normal forces of λ
    beside: csr_matrix  # (k q, m) proximal forces of w, beside T
    relative: csr_matrix  # (k q, m) κ of w, of nodes that follow others against theirs

    @classmethod
    def of(cls, state: InterfaceState, n: int, P: csr_matrix) -> SlipRows:
        """Of an interface, for n multipliers in all and the proximal term P (m, m)."""
        nodes, others, at = state.nodes, state.others, state.nodes.kappa.ravel()
        return cls(
            nodes.operator(others.gather @ nodes.tangential, n),
            nodes.operator(nodes.L_normal, n),
            nodes.theta * others.gather @ P[at],
            others.relative @ picking(at, P.shape[0]),
        )


@dataclass(frozen=True, eq=False)
class Rows:
    """Of the frames, E λ + D w, for one state of contact."""

    own: csr_matrix  # (n_v, m) of the frames
    E: csr_matrix  # (n_v, n)
    D: csr_matrix  # (n_v, m)
    gather: csr_matrix  # (n_v, n_v) forces at the frame's nodes, summed up where these balance
    seen: csr_matrix  # (n, n_v) L of the frames as supports see them
    pull: csr_matrix  # (n_v, n) of rows at supports that hold frames, by their gaps
    slips: list[SlipRows]  # per interface


class FrameRows:
    """Rows of the frames, made anew where what touches has changed.

    Args:
        states: of the interfaces.
        L_t: (n_v, n) what forces of the rows are to the frames.
        m: number of unknowns w.
        scale: stiffness of the surfaces [force / length].

    Attributes:
        epsilon: of the proximal term, of that stiffness.
    """

    def __init__(
        self,
        states: Sequence[InterfaceState],
        L_t: csr_matrix,
        m: int,
        scale: float,
    ) -> None:
        self._states, self._L_t, self._m, self._scale = states, L_t, m, scale
        self.epsilon = 0.0
        self._of: list[float] = []  # it, and changes of the states, that the rows are of
        self._rows: Any = None

    def rows(self) -> Rows:
        """The same object as long as nothing has changed."""
        of = [self.epsilon, *(s.touched for s in self._states)]
        if of == self._of:
            return cast("Rows", self._rows)
        n_v, n = self._L_t.shape
        gather = block_diag([s.others.frame_gather for s in self._states], format="csr")
        P = proximal_term(self._states, self._m, self.epsilon * self._scale)
        own = gather @ P[:n_v]
        relative = block_diag([s.others.frame_relative for s in self._states], format="csr")
        relative.resize(own.shape)
        slips = [SlipRows.of(s, n, P) for s in self._states]
        forces = gather @ self._L_t
        at_supports = np.concatenate([s.at_supports for s in self._states])
        seen, on_seen = self._L_t.T, forces
        if at_supports.any():
            seen = beside([s.nodes.seen_by(s.at_supports) for s in self._states])
            on_seen = gather @ seen.T
        pull = holding(at_supports, on_seen, self._scale)
        holds = pull @ seen
        holds.resize(own.shape)
        D = own + self._scale * relative + holds
        rows = self._rows = Rows(own, forces, D, gather, seen, pull, slips)
        self._of = of
        return rows

    def pull(self, moved: Array) -> float:
        """Largest force of the proximal term [force], which at rest is none.

        Args:
            moved: (m,) w less the term's centre [length].
        """
        if not any(s.law.opens for s in self._states):
            return 0.0
        now = self.rows()
        terms = [now.own, *(parts.beside for parts in now.slips)]
        return max(float(np.abs(term @ moved).max(initial=0.0)) for term in terms)
