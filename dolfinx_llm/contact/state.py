"""What an interface remembers in the iteration of its contact law, and its operators there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_matrix, diags, identity, vstack

from dolfinx_llm.interface.geometry import ContactModel
from dolfinx_llm.laws.law import CLOSED, OPEN, STICK
from dolfinx_llm.laws.speakers import follow, speakers, unheld
from dolfinx_llm.operators.assemble import interface_operator
from dolfinx_llm.operators.system import ContactOperators

LOOSE = 12  # a pair that has closed so often in a load step has no friction of its own
ADRIFT = 1e-2  # sum of N² of the pairs that follow it below which a frame node follows another
FLOOR = 1e-3  # what pairs without contact add to the support of a frame node


@dataclass(eq=False)
class InterfaceState:
    """One interface: its place in the vectors of all, and what is in contact.

    Friction nodes are the frame's nodes, the pairs themselves against a rigid obstacle. With two
    sides T = L_kappaᵀ λ / 2 and δ = 2 Δκ, since both slip by κ; theta is that 1/2, or 1. Nodes at
    the rim of contact slip as their ``speaker`` does (``rim``), where T and N of all are summed up.
    """

    model: ContactModel
    rows: np.ndarray  # (n, c) its multiplier rows
    v: np.ndarray  # (m d,) its frame unknowns
    kappa: np.ndarray  # (k, t) its slip unknowns; empty without friction
    kept: np.ndarray  # (n c,) rows that are not redundant (prescribed on both sides)
    L: csr_matrix  # (n c, m d)
    L_kappa: csr_matrix  # (n c, k t)
    L_normal: csr_matrix  # (k, n c) normal force at the friction nodes from λ
    theta: float
    active: np.ndarray = field(init=False)  # (n,) pairs in contact, changed by ``touch``
    coefficients: np.ndarray = field(init=False)  # (k,) of friction
    cohesive: np.ndarray = field(init=False)  # (k,) tangential force besides [force]
    closings: np.ndarray = field(init=False)  # (n,) how often they have closed in this load step
    status: np.ndarray = field(init=False)  # (k,) of the friction nodes
    kappa_before: np.ndarray = field(init=False)  # (k, t) at the end of the last load step [length]
    speaker: np.ndarray = field(init=False)  # (k,) the friction node whose law holds for each
    unheld: np.ndarray = field(init=False)  # (k,) friction nodes that no force reaches
    sums: csr_matrix = field(init=False)  # (k, k) values of all nodes at the speakers
    gather: csr_matrix = field(init=False)  # (k t, k t) the same for tangential forces
    relative: csr_matrix = field(init=False)  # (k t, k t) slip; of the others against speakers'

    def __post_init__(self):
        self._N = [p.N for p in self.model.pairs] if self.model.frame is not None else []
        k, t = self.kappa.shape
        self.speaker, self.sums = np.arange(k), identity(k, format="csr")
        self.unheld, self._touching = np.zeros(k, dtype=bool), np.empty(0)
        self.gather = self.relative = identity(k * t, format="csr")
        self.frame_gather = identity(len(self.v), format="csr")
        self.frame_relative = csr_matrix((len(self.v), len(self.v)))
        x, area = self._law_nodes()
        self.coefficients, self.cohesive = self.law.coefficients(x), area * self.law.cohesion_at(x)
        self._squares = [A.power(2).T.tocsr() for A in self._N or [identity(len(self.rows))]]
        self.forget()

    def _law_nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions (k, gdim) [length] and areas (k,) of the friction nodes."""
        pairs, frame = self.model.pairs[0], self.model.frame
        if not self.kappa.size:
            return pairs.x[:0], pairs.forces[:0]
        return (pairs.x, pairs.forces) if frame is None else (frame.x, pairs.N.T @ pairs.forces)

    @property
    def law(self):
        return self.model.interface.law

    def forget(self):
        """All in contact, no slip."""
        self.closings = np.zeros(len(self.rows), dtype=np.int64)
        self.touch(np.ones(len(self.rows), dtype=bool))
        self.status = np.full(len(self.kappa), STICK)
        self.kappa_before = np.zeros(self.kappa.shape)

    def begin(self):
        """Start a load step: pairs that opened and closed by turns get another chance."""
        self.closings[:] = 0
        self.touch(self.active)

    def snapshot(self) -> tuple:
        return self.active.copy(), self.status.copy(), self.kappa_before.copy()

    def restore(self, snapshot: tuple):
        active, self.status, self.kappa_before = (a.copy() for a in snapshot)
        self.touch(active)

    def touch(self, active: np.ndarray):
        """Take over the pairs (n,) in contact, and who speaks for whom."""
        self.active = active
        touching = np.stack([active, self._tied])
        if not (self._N and self.kappa.size) or np.array_equal(touching, self._touching):
            return
        self._touching = touching
        k, t = self.kappa.shape
        follows, touching = _of(self._N, self._tied), _of(self._N, self.active)
        self.speaker = speakers(follows, touching)
        self.unheld = unheld(follows, self.speaker)
        self.sums = csr_matrix((np.ones(k), (self.speaker, np.arange(k))), (k, k))
        alike = follow(self.speaker, self.model.directions[:, :-1])
        self.gather = alike.T.tocsr()
        weak = np.repeat(self.speaker != np.arange(k), t).astype(float)
        self.relative = (identity(k * t) - diags(weak) @ alike).tocsr()
        held = sum(np.asarray(N.power(2).sum(axis=0)).ravel() for N in follows)
        leader = np.where(held < ADRIFT, self.speaker, np.arange(k))
        self.frame_gather, self.frame_relative = _carried(leader, self.model.directions)

    def accept(self, w: np.ndarray, fitted: np.ndarray):
        """End a load step; where contact is open, κ follows the bodies."""
        if self.kappa.size:
            opened = (self.status == OPEN)[:, None]
            self.kappa_before = np.where(opened, fitted[self.kappa], w[self.kappa])

    @property
    def _tied(self) -> np.ndarray:
        """(n,) pairs that follow the frame tangentially. One that opens and closes by turns, at the
        rim of contact, carries hardly any force; without friction it comes to rest."""
        if self.model.frame is None:  # each pair has a friction node of its own
            return self.active
        return self.active & (self.closings < LOOSE)

    def loose_share(self, normal_forces) -> float:
        """Share of the normal force on pairs in contact that do not follow the frame tangentially.

        Args:
            normal_forces: per side (n_i,) [force].
        """
        force = np.concatenate(normal_forces)
        loose = self.active & ~self._tied
        return float(np.abs(force[loose]).sum() / max(np.abs(force).sum(), 1e-300))

    def closed_rows(self) -> np.ndarray:
        """(n c,) rows in contact."""
        closed = np.repeat(self._tied[:, None], self.rows.shape[1], axis=1)
        if self.law.unilateral:
            closed[:, -1] = self.active
        return closed.ravel() & self.kept

    def support(self, tied: bool) -> list[np.ndarray]:
        """Per side (k,) how firmly pairs hold the motion of the frame's nodes: the sum of N² over
        all pairs, or those tied to it and a little of the others."""
        weight, first, out = np.ones(len(self.rows)), 0, []
        if tied:
            weight = np.where(self._tied, 1.0, FLOOR)
        for squares in self._squares:
            n = squares.shape[1]
            least = FLOOR * squares.sum() / squares.shape[0]
            out.append(np.maximum(squares @ weight[first : first + n], least))
            first += n
        return out

    def slip_stiffness(self, scale: float) -> np.ndarray:
        """(k,) what slip at a friction node meets, about [force / length]."""
        return scale * self.theta * np.sum(self.support(tied=True), axis=0)

    def forces(self, multiplier: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tangential forces (k, t) that the law holds for, and their bound (k,) [force]."""
        own = multiplier[self.rows].ravel()
        T = self.gather @ (self.theta * (self.L_kappa.T @ own))
        bound = self._bound(self.L_normal @ own)
        return T.reshape(self.kappa.shape), self.sums @ bound

    def cohesion(self, multiplier: np.ndarray) -> np.ndarray:
        """(k,) part of the bound that does not grow with the normal force [force]."""
        normal = self.L_normal @ multiplier[self.rows].ravel()
        return self.sums @ np.where(normal > 0.0, self.cohesive, 0.0)

    def _bound(self, normal: np.ndarray) -> np.ndarray:
        """(k,) what tangential forces may reach for normal forces (k,), node by node [force]."""
        return self.coefficients * normal + np.where(normal > 0.0, self.cohesive, 0.0)

    def share_out(self, friction: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Forces of friction (k, gdim) of those that speak for others, divided among them as the
        bounds for normal forces (k,) are: what the law says of the sum then holds for each."""
        pressed = np.maximum(self._bound(normal), 0.0)
        total = (self.sums @ pressed)[self.speaker]
        part = np.where(total > 0.0, pressed / np.where(total > 0.0, total, 1.0), 0.0)
        tangents = self.model.directions[:, :-1]
        own = np.einsum("ki,kai->ka", friction, tangents)
        own = (self.gather.T @ (self.gather @ own.ravel())).reshape(own.shape)
        shared = part[:, None] * np.einsum("ka,kai->ki", own, tangents)
        return np.where((total > 0.0)[:, None], shared, friction)

    def slip(self, w: np.ndarray) -> np.ndarray:
        """(k, t) slip of this load step, of side 0 against side 1 [length]."""
        return (w[self.kappa] - self.kappa_before) / self.theta

    def friction_operator(self, C_T, C_N, n_all: int) -> csr_matrix:
        """C_T T + C_N S, with S the bound but for cohesion, as a matrix (k t, n_all) of all
        multipliers."""
        own = C_T @ self.gather @ (self.theta * self.L_kappa.T)
        own += C_N @ self.sums @ diags(self.coefficients) @ self.L_normal
        own = own.tocoo()
        return csr_matrix((own.data, (own.row, own.col + self.rows[0, 0])), (own.shape[0], n_all))

    def selection(self, m: int) -> csr_matrix:
        """(k t, m) matrix that picks κ from w."""
        at = self.kappa.ravel()
        return csr_matrix((np.ones(len(at)), (np.arange(len(at)), at)), (len(at), m))

    def pair_status(self) -> np.ndarray:
        """(n,) OPEN, STICK, SLIP or CLOSED per pair: with friction that of the friction node next
        to it, CLOSED where it has lost its own."""
        if not self.law.unilateral:
            return np.full(len(self.rows), STICK)
        status = np.full(len(self.rows), CLOSED)
        if self.law.friction:
            status = self.status
            if self.model.frame is not None:
                N = vstack([p.N for p in self.model.pairs]).tocsr()
                status = self.status[np.asarray(N.argmax(axis=1)).ravel()]
            status = np.where(status == OPEN, CLOSED, status)  # its node is not pressed
            status = np.where(self._tied, status, CLOSED)
        return np.where(self.active, status, OPEN)


def sticking_rows(state: InterfaceState) -> np.ndarray:
    """(n c,) rows in contact of pairs that have friction, where all sticks."""
    if not state.kappa.size:
        return np.zeros(state.rows.size, dtype=bool)
    moves = state.status != STICK
    if state.model.frame is not None:
        moves = vstack([p.N for p in state.model.pairs]) @ moves.astype(float) != 0.0
    return state.closed_rows() & np.repeat(~moves, state.rows.shape[1])


def _of(N: list[csr_matrix], pairs: np.ndarray) -> list[csr_matrix]:
    """Per side (n_i, m) shape functions of some of the pairs (n,)."""
    ends = np.cumsum([part.shape[0] for part in N])
    chosen = np.split(pairs.astype(float), ends[:-1])
    return [(diags(a) @ part).tocsr() for a, part in zip(chosen, N, strict=True)]


def _carried(leader: np.ndarray, directions: np.ndarray) -> tuple[csr_matrix, csr_matrix]:
    """Frame nodes that hardly any pair holds move tangentially as their leader (m,) does: sums of
    forces at the leaders, and tangential motion against theirs (m d, m d)."""
    m, d = directions.shape[:2]
    weak = np.repeat(leader != np.arange(m), d)
    weak[d - 1 :: d] = False
    follows = diags(weak.astype(float))
    moved = follows @ follow(leader, directions)
    return (diags((~weak).astype(float)) + moved.T).tocsr(), (follows - moved).tocsr()


def interface_states(operators: ContactOperators) -> list[InterfaceState]:
    """States of the interfaces, each with its places in the vectors of all."""
    states = []
    for model, place, L in zip(operators.models, operators.places, operators.blocks, strict=True):
        n, c = sum(len(p.nodes) for p in model.pairs), model.pairs[0].base.shape[1]
        L_kappa, across, theta = _slip_operators(model, n, c)
        rows, slips = (np.arange(at.start, at.stop) for at in (place.rows, place.slips))
        states.append(
            InterfaceState(
                model,
                rows=rows.reshape(n, c),
                v=np.arange(place.frame.start, place.frame.stop),
                kappa=slips.reshape(-1, c - 1 if len(slips) else 1),
                kept=~operators.redundant[place.rows],
                L=L,
                L_kappa=L_kappa,
                L_normal=across,
                theta=theta,
            )
        )
    return states


def _slip_operators(model, n: int, c: int):
    """L_kappa (n c, k t), N (k, n c) of the multipliers, and θ."""
    if not model.interface.law.friction:
        return csr_matrix((n * c, 0)), csr_matrix((0, n * c)), 1.0
    if model.frame is None:
        every, normal = identity(n * c, format="csr"), np.arange(n * c) % c == c - 1
        return every[:, ~normal], every[normal], 1.0
    # Both sides slip by κ in their own base, (13).
    sides = [replace(p, base=sign * p.base) for p, sign in zip(model.pairs, (1.0, -1.0))]
    across = interface_operator(sides, model.directions[:, -1:])
    return interface_operator(sides, model.directions[:, :-1]), 0.5 * across.T.tocsr(), 0.5
