"""Equations of contact laws: laws and what is in contact make a ``LinearStep``.

Frictionless contact is a convex quadratic programme: the frame is a surface that separates the
bodies; on each side λ_n >= 0, gap >= 0, λ_n gap = 0, and L_bᵀ λ = 0 ((12), (15)). v is free where
contact is open; a proximal term -ε c (v - v_c) settles it. Friction adds Newton rows per frame node
in the slip κ of (13). Works on the interface alone: arrays that are the same on every rank.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import block_diag, bsr_matrix, coo_matrix, csr_matrix, diags, hstack, identity
from scipy.sparse import vstack as stack
from scipy.sparse.linalg import splu

from dolfinx_llm.contact.state import InterfaceState, interface_states
from dolfinx_llm.forms.step import SOFT, LinearStep
from dolfinx_llm.laws.law import STICK, LawRows
from dolfinx_llm.operators.system import ContactOperators


class Equations:
    """What the laws of all interfaces ask of multipliers λ and frame unknowns w.

    Args:
        operators: of the interfaces.
        proximal: what holds frame nodes that nothing touches, of the surfaces' stiffness.

    Attributes:
        states: per interface its ``InterfaceState``.
        L: (n, m) motion of frames and slips as the rows see it.
        compliance: (n,) by how much rows give way [length / force].
        normal: (n,) rows that may open.
        drifts: (m,) normal motion of frames.
    """

    def __init__(self, operators: ContactOperators, proximal: float) -> None:
        self.scale, self._epsilon = operators.scale, proximal
        self._opens, self._floating = operators.opens, operators.floating
        self.states = interface_states(operators)
        self.n = sum(state.rows.size for state in self.states)
        soft = operators.soft & operators.opens  # ties alone leave no force to laws
        self.compliance = np.where(soft, SOFT / self.scale, 0.0)
        L = block_diag([state.L for state in self.states], format="csr")
        L_kappa = block_diag([state.L_kappa for state in self.states], format="csr")
        kept = diags(np.concatenate([s.kept for s in self.states]).astype(float))
        self.L = (kept @ hstack([L, L_kappa])).tocsr()
        self.n_v, self.m = L.shape[1], self.L.shape[1]
        self._L_t = self.L[:, : self.n_v].T.tocsr()
        self.normal = np.zeros(self.n, dtype=bool)
        self.drifts = np.zeros(self.m, dtype=bool)
        for s in self.states:
            self.normal[s.rows[:, -1]] = s.law.unilateral
            if len(s.v):
                self.drifts[s.v.reshape(-1, s.model.directions.shape[1])[:, -1]] = True

    def closed_rows(self) -> np.ndarray:
        """(n,) rows in contact."""
        return np.concatenate([s.closed_rows() for s in self.states])

    def middle(self, position: np.ndarray) -> np.ndarray:
        """(m,) frame that fits the positions of all rows best; where nothing opens nobody asks."""
        if not (self.m and self._opens):
            return np.zeros(self.m)
        return self._fit.solve(self.L.T @ position)

    @cached_property
    def _fit(self) -> Any:
        """Factorised LᵀL."""
        return splu((self.L.T @ self.L + 1e-10 * identity(self.m)).tocsc())

    def step(
        self, about: Any, g: np.ndarray, centre: np.ndarray, held: Any, calmed: bool
    ) -> LinearStep:
        """The linear equations of one iteration about λ and w.

        Args:
            about: λ and w of the last iterate.
            g: gaps.
            centre: of the proximal term.
            held: where springs hold free bodies, and their stiffness.
            calmed: as of ``friction_rows``.
        """
        active = self.closed_rows()
        P = self._proximal()
        gather = self._frame_gather()
        own = gather @ P[: self.n_v]
        relative = block_diag([s.frame_relative for s in self.states], format="csr")
        relative.resize(own.shape)
        E, D, rhs = [gather @ self._L_t], [own + self.scale * relative], [own @ centre]
        for s in self.states:
            if s.kappa.size:
                rows = self.friction_rows(s, about[0], about[1], calmed)
                C_T, C_delta = _blocks(rows.C_T), _blocks(rows.C_delta) / s.theta
                E.append(s.friction_operator(C_T, _blocks(rows.C_N[:, :, None]), self.n))
                # The proximal force stands beside T.
                own = s.theta * C_T @ s.gather @ P[s.kappa.ravel()]
                C_delta = C_delta @ s.relative
                D.append(own + C_delta @ s.selection(self.m))
                given = rows.rhs - rows.C_N * s.cohesion(about[0])[:, None]
                rhs.append(own @ centre + given.ravel() + C_delta @ s.kappa_before.ravel())
        anchor, spring = held
        return LinearStep(
            active, self.normal, self.L, g, self.compliance,
            stack(E, format="csr"), stack(D, format="csr"), np.concatenate(rhs),
            anchor, spring, self._floating.pins, spring * self._floating.at_pins(anchor),
        )  # fmt: skip

    def friction_rows(
        self, s: InterfaceState, multiplier: np.ndarray, w: np.ndarray, calmed: bool
    ) -> LawRows:
        """Rows of an interface's law, linearised about λ and w.

        Args:
            s: the interface.
            multiplier, w: λ (n,) and w (m,) of the last iterate.
            calmed: the state of contact has come to rest once in this load step; from then on what
                no force reaches sticks.
        """
        T, bound = s.forces(multiplier)
        rows = s.law.rows(T, bound, s.slip(w), s.slip_stiffness(self.scale), s.status)
        return rows.tied(s.speaker, s.unheld & calmed, self.scale)

    def all_stick(self, step: LinearStep) -> LinearStep:
        """The first step, when nothing is known: all stick, as in the paper."""
        for s in self.states:
            s.status[:] = STICK
        first, count = self.n_v, self.m - self.n_v
        select = csr_matrix((np.ones(count), (np.arange(count), first + np.arange(count))),
                            (count, self.m))  # fmt: skip
        E = stack([step.E[:first], csr_matrix((count, self.n))], format="csr")
        D = stack([step.D[:first], self.scale * select], format="csr")
        before = [s.kappa_before.ravel() for s in self.states]
        rhs = np.concatenate([step.rhs[:first], self.scale * np.concatenate(before)])
        return replace(step, E=E, D=D, rhs=rhs)

    def _proximal(self) -> csr_matrix:
        """(m, m) matrix of the proximal term -ε c (w - w_c).

        With friction each side's own field, v + κ and v - κ, is held as firmly as its pairs are.
        """
        row, col, value = [np.empty(0, dtype=int)], [np.empty(0, dtype=int)], [np.empty(0)]

        def add(i: np.ndarray, j: np.ndarray, x: Any) -> None:
            row.append(i)
            col.append(j)
            value.append(-self._epsilon * self.scale * x)

        for s in self.states:
            if not s.law.unilateral:
                continue
            support, t = s.support(tied=True), s.kappa.shape[1] if s.kappa.size else 0
            both = sum(support)
            if len(s.v):
                v = s.v.reshape(-1, s.model.directions.shape[1])
                add(v[:, -1], v[:, -1], sum(s.support(tied=False)))
                for i in range(t):
                    difference = support[0] - support[1]
                    add(v[:, i], v[:, i], both)
                    add(v[:, i], s.kappa[:, i], difference)
                    add(s.kappa[:, i], v[:, i], difference)
            for i in range(t):
                add(s.kappa[:, i], s.kappa[:, i], both)
        index = np.concatenate(row), np.concatenate(col)
        return coo_matrix((np.concatenate(value), index), (self.m, self.m)).tocsr()

    def miss(self, multiplier: np.ndarray, w: np.ndarray) -> float:
        """By how much balance of the frames and the laws are missed, at most [force]."""
        return max(self.imbalance(multiplier), self._friction_miss(multiplier, w))

    def imbalance(self, multiplier: np.ndarray) -> float:
        """Largest entry of L_bᵀ λ [force]; of nodes that follow others in the sum with theirs."""
        return float(np.abs(self._frame_gather() @ (self._L_t @ multiplier)).max(initial=0.0))

    def _frame_gather(self) -> csr_matrix:
        """(n_v, n_v) forces at the frame's nodes, summed up where equilibrium is asked for."""
        return block_diag([s.frame_gather for s in self.states], format="csr")

    def _friction_miss(self, multiplier: np.ndarray, w: np.ndarray) -> float:
        """Largest distance of a tangential force from Coulomb's law [force]."""
        worst = 0.0
        for s in self.states:
            if s.kappa.size:
                T, bound = s.forces(multiplier)
                miss = s.law.miss(T, bound, s.slip(w), s.slip_stiffness(self.scale))
                worst = max(worst, float(miss.max(initial=0.0)))
        return worst


def _blocks(C: np.ndarray) -> csr_matrix:
    """Block diagonal matrix of (n, a, b)."""
    n = len(C)
    return bsr_matrix((C, np.arange(n), np.arange(n + 1)), (n * C.shape[1], n * C.shape[2])).tocsr()
