"""What an interface remembers in the iteration of its contact law."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.contact.equations.at_supports import at_supports
from dolfinx_llm.contact.equations.friction_nodes import FLOOR, FrictionNodes
from dolfinx_llm.contact.equations.speakers import ADRIFT, Followers, LastFollowers
from dolfinx_llm.interface.update import Transfer
from dolfinx_llm.laws.answers import at_nodes, kept_by, rows_of
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.rows import CLOSED, OPEN, SLIP, STICK, LawNodes, LawRows

BY_TURNS = 12  # a pair that has closed so often in a load step does not come to rest
GONE = 1000  # one that is left without friction of its own


@dataclass(eq=False)
class ContactState:
    """What is in contact, sticks and slips, and what the law keeps; plain arrays."""

    active: Array  # (n,) pairs in contact
    closings: Array  # (n,) how often they have closed in this load step
    status: Array  # (k,) of the nodes at which the law holds
    kappa_before: Array  # (k, q) jump unknowns at the end of the last load step [length]
    holds: Array  # (k,) nodes whose pairs may pull, too
    history: dict[str, Array]  # (k, ...) what the law keeps
    ties: Array | None = None  # (n,) pairs that follow a frame along it; None: those in contact

    @classmethod
    def at_first(cls, n: int, jumps: tuple[int, ...]) -> ContactState:
        """All n pairs in contact, no jump at k nodes, (k, q); as drawn."""
        k = jumps[0]
        return cls(
            active=np.ones(n, dtype=bool),
            closings=np.zeros(n, dtype=np.int64),
            status=np.full(k, STICK),
            kappa_before=np.zeros(jumps),
            holds=np.zeros(k, dtype=bool),
            history={},
        )

    def copy(self) -> ContactState:
        """With arrays of its own."""
        return ContactState(
            active=self.active.copy(),
            closings=self.closings.copy(),
            status=self.status.copy(),
            kappa_before=self.kappa_before.copy(),
            holds=self.holds.copy(),
            history={name: value.copy() for name, value in self.history.items()},
            ties=None if self.ties is None else self.ties.copy(),
        )

    def carried(self, transfer: Transfer, fresh: ContactState) -> ContactState:
        """The same on another geometry of the interface.

        Jumps and what the law keeps are interpolated between the frame's nodes, status is that of
        the nearest; against an obstacle both go with their pair.

        Args:
            transfer: from this geometry to that one.
            fresh: a state of that one.
        """
        old, state = transfer.old_pairs, fresh.copy()
        state.active, state.closings = self.active[old], self.closings[old]
        if not len(fresh.status):
            return state
        N = transfer.nodes
        nearest = np.asarray(abs(N).argmax(axis=1)).ravel()
        state.status, state.holds = self.status[nearest], self.holds[nearest]
        state.kappa_before = transfer.turned(self.kappa_before)
        for name in self.history.keys() & state.history.keys():
            value = self.history[name]
            now = N @ value.reshape(len(value), -1)
            state.history[name] = now.reshape(-1, *value.shape[1:])
        return state


class InterfaceState:
    """One interface in the iteration: its law's nodes, its state, and what follows from both.

    Nodes of friction at the rim of contact slip as their speakers do (``speakers``), where T
    and N of all are summed up. Those that next to nothing holds also move with it at first.

    Args:
        nodes: of the interface.

    Attributes:
        nodes, own: as given; the state.
        given: what the law has read at the start of this load step, (k, ...) by name.
        others, touched: who speaks for whom; counts the changes of what is in contact.
        held: (n,) pairs that may pull, too.
        clamped, overlap: (n,) pairs that hold the frame, and of bodies there, see ``clamped``.
        torn: (n,) by how much ties are not met, where others hold all [length].
        shares: nodes at the rim of contact slip as others do; in a plane alone, see ``carrier``.
        second, keeps: of second order, whose pairs that do not come to rest may keep their ties;
            whether they do, see ``flickering``.
        adrift, asked: (k,) see ``Followers``; whether ties have been chosen in this load step.
        grazes: friction of open pairs, over the normal force.
        pulled: (k,) nodes that corrected rows pull at, or push along: they slip as another does.
        still, at_supports: (m d,) motions of the frame that supports tell; (n c,) by which rows.
    """

    def __init__(self, nodes: FrictionNodes) -> None:
        self.nodes, law = nodes, nodes.law
        rubs = law.shares and law.opens and law.slips and not law.gives
        self.shares = rubs and nodes.geometry.law_side is None
        self.second = self.shares and any(p.control is not None for p in nodes.geometry.pairs)
        self.torn, self.overlap = np.zeros(len(nodes.rows)), 0.0
        self.glides = False  # or all follow the frame
        self.touched, self._touching = 0, np.empty(0)
        self.stays, self.clamped = np.zeros((2, len(nodes.rows)), dtype=bool)  # cannot part
        self.others, self._followers = Followers.none(nodes), LastFollowers(nodes)
        self.given: dict[str, Array] = {}
        self.forget()

    @property
    def law(self) -> Law:
        """Of the interface."""
        return self.nodes.law

    def forget(self) -> None:
        """All in contact, no jump, as drawn."""
        self.own = ContactState.at_first(len(self.nodes.rows), self.nodes.kappa.shape)
        self.begin()
        if self.nodes.kappa.size:
            with collective(self.nodes.comm):
                self.own.history = kept_by(self.law, "start", self.at_rest())
            self.read()
            self.take(self.rows_at(self.at_rest()))
            self.own.status = np.full(len(self.nodes.kappa), STICK)

    def read(self) -> None:
        """At the start of a load step: what users give and may have changed; collective."""
        if self.nodes.kappa.size:
            with collective(self.nodes.comm):
                self.given = kept_by(self.law, "begin_step", self.at_rest())

    def begin(self, adrift: float | Array = ADRIFT, keeps: bool = False) -> None:
        """Start a load step: pairs that opened and closed by turns get another chance."""
        self.own.closings[:], self.asked, self.keeps = 0, 0, keeps
        self.adrift, self.grazes = adrift * np.ones(len(self.nodes.kappa)), 0.0
        self.pulled = np.zeros(len(self.nodes.kappa), dtype=bool)
        self.still, self.at_supports = at_supports(self.nodes)
        self.touch(self.own.active)

    def restore(self, state: ContactState) -> None:
        """Take over another state."""
        self.own = state.copy()
        self.touch(self.own.active)

    def touch(self, active: Array) -> None:
        """Take over the pairs (n,) in contact, and who speaks for whom."""
        holds = self.stays | self.clamped | self.nodes.geometry.prescribed
        self.held = self.nodes.reach(self.own.holds) | holds
        self.own.active = active = active | self.held
        chosen, slips = self.own.ties is not None, self.own.status == SLIP
        near = active | (self.own.closings >= BY_TURNS)  # or who speaks would change by turns, too
        told = self.tied, near, self.pulled, self.adrift, self.still, chosen
        now = np.hstack([*told, slips & self.others.turns])
        if not np.array_equal(now, self._touching):
            self._touching, self.touched = now, self.touched + 1
            if self.shares:
                self.others = self._followers.of(*told, slips)

    def take(self, rows: LawRows) -> None:
        """Take over what law rows say of the nodes."""
        self.own.status, self.own.holds = rows.status, np.asarray(rows.holds, dtype=bool)
        self.touch(self.own.active)

    def accept(self, multiplier: Array, w: Array, fitted: Array, c: float, least: float) -> None:
        """End a load step; where contact is open, or bears nothing, slips follow the bodies.

        Args:
            multiplier, w: λ (n,) and w (m,).
            fitted: (m,) frames and slips that fit the bodies best.
            c: stiffness of the surfaces [force / length].
            least: rounding of forces [force].
        """
        if self.nodes.kappa.size:
            at, kappa, opened = self.at(multiplier, w, c), self.nodes.kappa, self.own.status == OPEN
            with collective(self.nodes.comm):
                self.own.history = kept_by(self.law, "end_step", at)
                if self.law.opens and self.law.slips:
                    opened = opened | (at_nodes(self.law, "strength", at) <= least)
                    opened = opened[self.others.speaker]  # those that follow it slip as it does
            self.own.kappa_before = np.where(opened[:, None], fitted[kappa], w[kappa])

    @property
    def tied(self) -> Array:
        """(n,) pairs that follow the frame tangentially. One that opens and closes by turns carries
        hardly any force; it comes to rest without friction, or with its tie, pressing or not."""
        law, active, closings = self.law, self.own.active, self.own.closings
        if law.follows or law.gives or self.nodes.geometry.law_side is not None or not law.slips:
            holding = self.nodes.holding(active) | law.follows
            return holding & self.nodes.carries if self.glides else holding
        settling = active & (closings < BY_TURNS)
        if self.keeps:
            settling = (active | (closings >= BY_TURNS)) & (closings < GONE)
        return (settling if self.own.ties is None else self.own.ties) & (not self.glides)

    def closed_rows(self) -> Array:
        """(n c,) rows in contact."""
        closed = np.repeat(self.tied[:, None], self.nodes.rows.shape[1], axis=1)
        if self.law.opens:
            closed[:, -1] = self.own.active
        return closed.ravel() & self.nodes.kept

    def support(self, tied: bool) -> list[Array]:
        """Per side (k,) how firmly all pairs hold the motion of the nodes, or those tied to them
        and a little of the others."""
        return self.nodes.support(np.where(self.tied | (not tied), 1.0, FLOOR))

    def at_rest(self) -> LawNodes:
        """What the law is told where nothing moves and presses."""
        nodes, (k, q) = self.nodes, self.nodes.kappa.shape
        return LawNodes(
            nodes.x, nodes.area, force=np.zeros((k, q)), N=np.zeros(k), jump=np.zeros((k, q)),
            before=np.zeros((k, q)), c=np.ones(k), status=self.own.status,
            history=self.own.history, sample=nodes.sample, given=self.given,
        )  # fmt: skip

    def at(self, multiplier: Array, w: Array, c: float) -> LawNodes:
        """What the law is told of its nodes.

        Args:
            multiplier, w: λ (n,) and w (m,).
            c: stiffness of the surfaces [force / length].
        """
        nodes, own = self.nodes, multiplier[self.nodes.rows].ravel()
        T = self.others.gather @ (nodes.theta * (nodes.L_kappa.T @ own))
        jump = w[nodes.kappa] / nodes.theta
        if self.law.opens and self.law.gives:
            pulls = nodes.reached(self.held)
            jump[:, -1] = np.where(pulls, jump[:, -1], np.maximum(jump[:, -1], 0.0))
        return replace(
            self.at_rest(),
            force=T.reshape(nodes.kappa.shape),
            N=nodes.L_normal @ own,
            jump=jump,
            before=self.own.kappa_before / nodes.theta,
            c=c * nodes.softer * nodes.theta * np.sum(self.support(tied=True), axis=0),
            shared=self.others.sums if self.shares else None,
        )

    def rows_at(self, nodes: LawNodes) -> LawRows:
        """Rows of the law about an iterate; collective. It raises what ``rows_of`` does."""
        with collective(self.nodes.comm):
            return rows_of(self.law, nodes)

    def share_out(self, friction: Array, normal: Array) -> Array:
        """Forces of friction (k, gdim) of those that speak for others, divided among them by their
        strength for normal forces (k,): what the law says of the sum then holds for each."""
        if not self.shares:
            return friction
        with collective(self.nodes.comm):
            bears = at_nodes(self.law, "strength", replace(self.at_rest(), N=normal))
        return self.others.share(friction, np.maximum(bears, 0.0))

    def pair_status(self) -> Array:
        """(n,) OPEN, STICK, SLIP or CLOSED per pair: with friction that of the node next to it,
        CLOSED where it has lost its own."""
        if self.law.ties:
            return np.full(len(self.nodes.rows), STICK)
        status = np.full(len(self.nodes.rows), CLOSED)
        if self.nodes.kappa.size:
            status = self.nodes.next_to(self.own.status)
            status = np.where(self.tied & (status != OPEN), status, CLOSED)  # OPEN: not pressed
        return np.where(self.own.active, status, OPEN)

    def bearing_rows(self) -> Array:
        """(n c,) rows in contact that have friction."""
        holding = self.nodes.holding(self.own.active)
        rows = self.closed_rows().reshape(self.nodes.rows.shape) & holding[:, None]
        rows[:, -1] = False
        return rows.ravel() & bool(self.nodes.kappa.size)
