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
from scipy.sparse import csr_matrix, hstack, identity
from scipy.sparse import vstack as stack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.base.sparse import below, beside, diagonal, per_item, picking, symmetric_factors
from dolfinx_llm.contact.equations.at_supports import borne
from dolfinx_llm.contact.equations.clamped import HeldRows
from dolfinx_llm.contact.equations.friction_nodes import friction_nodes
from dolfinx_llm.contact.equations.prescribed_slip import rows_of, told
from dolfinx_llm.contact.equations.proximal import FrameRows
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.forms.step import LEAST_FELT, SIGN, SOFT, LinearStep
from dolfinx_llm.laws.answers import at_nodes
from dolfinx_llm.laws.rows import STICK, UNBOUNDED, LawRows
from dolfinx_llm.operators.system import ContactOperators

ROUNDED_OFF = 4.0 * float(np.finfo(float).eps)  # of forces, before rows give way by it
CARRIED = 1e-3  # part of a force on an obstacle from which on contact does not balance it


class Equations:
    """What the laws of all interfaces ask of multipliers λ and frame unknowns w.

    Args:
        operators: of the interfaces.

    Attributes:
        operators, states, frames: as given; per interface its ``InterfaceState``; rows of the
            frames.
        L: (n, m) motion of frames and slips as the rows see it.
        L_t: (n_v, n) what forces of the rows are to the frames.
        compliance: (n,) by how much rows give way, as springs do [length / force].
        lags: normal forces that bound friction are those of the last iterate.
        trust: in slips of the last iterate, see ``newton_rows``.
        soft: (n,) rows that give way to changes alone: supports, or other rows of the same nodes,
            leave forces open.
        gives: by how much these do, over the surfaces' compliance.
        least: where all forces are below, they are none: rounding of what came here [force].
        idle: forces [force] up to which interfaces stick: weak springs alone press there, and lead
            bodies that have come free away.
        start: (n,) λ at the start of the load step: friction at rest keeps it [force].
        g: (n,) gaps of the load step [length].
        about: (n,) λ about which these do, at a solution the solution's [force].
        left_out: (n,) normal rows in this load step, see ``clamped``.
        normal, drifts: (n,) rows that may open; (m,) normal motion of frames.
        loads: (n_v,) on the frame unknowns, forces on obstacles, at the part of the load step that
            has been reached [force].
    """

    def __init__(self, operators: ContactOperators) -> None:
        self.scale, self.lags, self.trust = operators.scale, False, UNBOUNDED
        self.states = [InterfaceState(nodes) for nodes in friction_nodes(operators)]
        places = [state.nodes for state in self.states]
        self.n = sum(nodes.rows.size for nodes in places)
        # Of ties no row that repeats others is in contact.
        loose = np.concatenate([np.full(nodes.rows.size, not nodes.law.ties) for nodes in places])
        self.soft = (operators.soft | operators.loops) & loose
        self.gives, self._joined = SOFT, bool(operators.loops.any())
        self.compliance = np.zeros(self.n)
        L, L_kappa = beside([s.L for s in places]), beside([s.L_kappa for s in places])
        self.L_t, self.n_v = L.T.tocsr(), L.shape[1]
        self.L = hstack([L, L_kappa], format="csr") if L_kappa.shape[1] else L
        self.m = self.L.shape[1]
        self.frames = FrameRows(self.states, self.L_t, self.m, self.scale)
        self.operators, self.loads = operators, np.zeros(self.n_v)
        self.start, self.about, self.g = np.zeros((3, self.n))
        self.left_out = np.zeros(self.n, dtype=bool)
        self.idle = self.least = 0.0
        self._rigid = np.zeros(self.m)  # 1: translations of obstacles, the others nodal motions
        self.normal = np.zeros(self.n, dtype=bool)
        self.drifts = np.zeros(self.m, dtype=bool)
        for nodes in places:
            self.normal[nodes.rows[:, -1]] = nodes.law.opens
            self._rigid[nodes.v] = nodes.geometry.rigid
            if not nodes.geometry.rigid:
                v = nodes.v.reshape(-1, nodes.geometry.directions.shape[1])
                self.drifts[v[:, -1]] = True

    @property
    def felt(self) -> float:
        """Part of the largest force that is more than rounding: that of rows of joints is divided
        by what they give way."""
        return max(SIGN, ROUNDED_OFF / self.gives) if self._joined else SIGN

    def closed_rows(self) -> Array:
        """(n,) rows in contact."""
        return np.concatenate([s.closed_rows() for s in self.states]) & ~self.left_out

    def may_open(self) -> Array:
        """(n,) rows of normal forces that press or are none."""
        may_open = self.normal & ~self.left_out
        for s in self.states:
            may_open[s.nodes.rows[s.held, -1]] = False
        return may_open

    def begin(self, multiplier: Array, moved: float, g: Array) -> None:
        """A load step from λ (n,), with gaps g (n,); bodies have moved so far at their surfaces:
        not the frames, which go anywhere between bodies that are apart."""
        self.idle, self.start, self.g = 0.0, multiplier, g
        self.least = LEAST_FELT * self.scale * moved
        if self.normal.any():
            self.left_out = self._held.hold(self.states, g)

    @cached_property
    def _held(self) -> HeldRows:
        return HeldRows(self.operators, self.normal, self.L, self.drifts)

    def frame_loads(self) -> Array:
        """(n_v,) loads on the frame unknowns that are prescribed now [force], or an error."""
        return self.operators.frame_loads()

    def middle(self, position: Array, w: Array) -> Array:
        """(m,) frame that fits the positions of all rows best; obstacles stay as in w (m,). Ties
        alone do not ask for it."""
        if not self.m or self.operators.tied:
            return np.zeros(self.m)
        own = self._rigid * w
        fitted = self._fit.solve(self.L.T @ (position - self.L @ own))
        return np.where(self._rigid > 0.0, own, fitted)

    @cached_property
    def _fit(self) -> Any:
        """Factorised LᵀL."""
        fitted = self.L @ diagonal(1.0 - self._rigid)
        return symmetric_factors(fitted.T @ fitted + 1e-10 * identity(self.m))

    def step(self, about: Any, g: Array, centre: Array, held: Any, calmed: bool) -> LinearStep:
        """The linear equations of one iteration about λ and w.

        Args:
            about: λ and w of the last iterate.
            g: gaps.
            centre: of the proximal term.
            held: where springs hold free bodies, and their stiffness.
            calmed: as of ``law_rows``.
        """
        if self.operators.tied:
            return replace(self._ties, g=g, rhs=self.loads)
        active = self.closed_rows()
        kept = np.where(active, self.about, 0.0)
        compliance = np.where(self.soft, self.gives / self.scale, self.compliance)
        now = self.frames.rows()
        E, D, rhs = [now.E], [now.D], [now.own @ centre + self.loads + now.pull @ g]
        for s, parts in zip(self.states, now.slips, strict=True):
            if s.nodes.kappa.size:
                rows = self.law_rows(s, about[0], about[1], calmed)
                C_T, C_jump = per_item(rows.C_T), per_item(rows.C_jump / s.nodes.theta)
                E.append(_on_forces(s, rows, C_T @ parts.T, parts.N))
                # The proximal force stands beside T.
                own = C_T @ parts.beside
                D.append(own + C_jump @ parts.relative)
                before = C_jump @ (s.others.relative @ s.own.kappa_before.ravel())
                rhs.append(own @ centre + rows.rhs.ravel() + before)
        (anchor, spring), floating = held, self.operators.floating
        return LinearStep(
            active, self.may_open(), self.L, g + self.soft * compliance * kept, compliance,
            below(E), below(D), np.concatenate(rhs),
            anchor, spring, floating.pins, spring * floating.at_pins(anchor), kept, self.least,
        )  # fmt: skip

    @cached_property
    def _ties(self) -> LinearStep:
        """The step of ties alone, but for g."""
        step = LinearStep.tied(self.L, np.zeros(self.n), self.L_t)
        return replace(step, active=self.closed_rows())

    def law_rows(self, s: InterfaceState, multiplier: Array, w: Array, calmed: bool) -> LawRows:
        """Rows of an interface's law, linearised about λ and w.

        Args:
            s: the interface.
            multiplier, w: λ (n,) and w (m,) of the last iterate.
            calmed: the state of contact has come to rest once in this load step; from then on what
                no force reaches sticks.
        """
        rows = rows_of(s, multiplier, self.start, w, self.scale, self.trust)
        if self.lags and s.law.shares:
            rows = rows.lagged(s.at(multiplier, w, self.scale))
        light = np.abs(multiplier[s.nodes.rows]).max(initial=0.0) <= self.idle
        unheld = s.others.unheld & calmed | (light and s.law.slips and not s.law.gives)
        if s.law.slips and not (s.law.gives or s.nodes.kept.all()):
            unheld |= ~(s.others.sums @ s.nodes.seen.astype(float) > 0.0)
        return rows.tied(s.others.speaker, unheld, self.scale)

    def all_stick(self, step: LinearStep) -> LinearStep:
        """The first step, when nothing is known: all stick, as in the paper; but where nothing
        opens or slips, which is solved at once."""
        if not any(s.law.opens or s.law.slips for s in self.states):
            return step
        for s in self.states:
            s.own.status = np.full(len(s.nodes.kappa), STICK)
        first, count = self.n_v, self.m - self.n_v
        if not count:
            return step
        select = picking(first + np.arange(count), self.m)
        E = stack([step.E[:first], csr_matrix((count, self.n))], format="csr")
        D = stack([step.D[:first], self.scale * select], format="csr")
        before = [s.own.kappa_before.ravel() for s in self.states]
        rhs = np.concatenate([step.rhs[:first], self.scale * np.concatenate(before)])
        return replace(step, E=E, D=D, rhs=rhs)

    def miss(self, multiplier: Array, w: Array) -> float:
        """By how much balance of the frames and the laws are missed, at most [force]."""
        return max(self.imbalance(multiplier, w), _law_miss(self, multiplier, w))

    def with_supports(self, multiplier: Array, w: Array) -> Array:
        """λ (n,) with what supports bear by rows that are left out, which hold frames [force]."""
        rows = np.concatenate([s.at_supports for s in self.states])
        if not rows.any():
            return multiplier
        opening = self.frames.rows().seen @ w[: self.n_v] - self.g
        return multiplier + borne(rows, opening, self.scale)

    def imbalance(self, multiplier: Array, w: Array) -> float:
        """Largest entry of L_bᵀ λ less its loads [force]; of nodes that follow others in the sum
        with theirs."""
        forces = on_frames(self, multiplier, w)
        if not self.operators.tied:
            forces = self.frames.rows().gather @ forces
        return float(np.abs(forces - self.loads).max(initial=0.0))


def on_frames(equations: Equations, multiplier: Array, w: Array) -> Array:
    """(n_v,) forces on the frame unknowns, of pairs and of what supports bear [force].

    Args:
        equations: of the laws.
        multiplier, w: λ (n,) [force] and w (m,) [length].
    """
    forces, told = equations.L_t @ multiplier, equations.with_supports(multiplier, w)
    if told is multiplier:
        return forces
    return forces + equations.frames.rows().seen.T @ (told - multiplier)


def runaway(equations: Equations, multiplier: Array) -> str:
    """What is said of an obstacle whose force contact does not balance: all but the proximal
    term gives way to it. Empty where there is none."""
    left = equations.loads - equations.L_t @ multiplier
    for s in equations.states:
        geometry = s.nodes.geometry
        obstacle, gdim = geometry.interface.obstacle, geometry.directions.shape[2]
        force = np.abs(equations.loads[s.nodes.v]).max(initial=0.0)
        missed = np.abs(left[s.nodes.v]).max(initial=0.0)
        if obstacle is not None and missed > CARRIED * force > 0.0:
            return (
                f"interface {geometry.interface.name}: contact does not balance the force on "
                f"the {type(obstacle).__name__}, {obstacle.pose(gdim)[3]}: "
                f"at least {missed / force:.2g} of it is left. It is pulled off, or slides "
                "without end: give None where its displacement is to be prescribed, or change "
                "the force"
            )
    return ""


def spread(equations: Equations, noise: float) -> float:
    """Noise of multipliers times how many balance at a frame node, at most: so often its balance is
    rounded [force]."""
    return noise and noise * float(
        np.asarray(abs(equations.L[:, : equations.n_v]).sum(axis=0)).max(initial=1.0)
    )


def _law_miss(equations: Equations, multiplier: Array, w: Array) -> float:
    """Largest distance of a force from its law [force]."""
    worst, c = 0.0, equations.scale
    for s in equations.states:
        if s.nodes.kappa.size:
            rests, _ = told(s, multiplier, equations.start, w, c)
            with collective(s.nodes.comm):
                at = replace(s.at(multiplier, w, c), jump=rests.jump)
                miss = at_nodes(s.law, "miss", at)
            worst = max(worst, float(miss.max(initial=0.0)))
    return worst


def _on_forces(s: InterfaceState, rows: LawRows, own: csr_matrix, normal: csr_matrix) -> csr_matrix:
    """C_T T + C_N S as a matrix (k q, n) of λ, for C_T T, ``own``, and the normal forces (k, n)."""
    if not rows.C_N.any():
        return own
    bears = normal if rows.weight is None else diagonal(rows.weight) @ normal
    return own + per_item(rows.C_N[:, :, None]) @ (s.others.sums @ bears)
