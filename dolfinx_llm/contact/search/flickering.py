"""Pairs that open and close by turns, just about to part, with friction of their own or without.

The tie of a pair bears any force, however little the pair presses. One that is pulled open by its
tie, and presses without it, is in between: it touches without pressing, and its tie bears a part of
the friction of those next to it. Such pairs are left without friction of their own. Where ties
have been chosen (``ties``), and where friction alone holds bodies of second order, they keep their
ties, open or not, as long as they are open by next to nothing, or bear little.
"""

from __future__ import annotations

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.contact.equations.equations import Equations, on_frames
from dolfinx_llm.contact.equations.state import BY_TURNS, GONE, InterfaceState
from dolfinx_llm.contact.search.blind import require_sight
from dolfinx_llm.laws.rows import SLIP, STICK

FRICTIONLESS = 1e-2  # of the normal force that may be without friction: less than meshes cost
ALONE = 4  # closings for which one counts where hardly any other pair changes
FEW = 0.02  # of the pairs: where no more change, those that close do so for reasons of their own
HEAVIEST = 0.5  # of the largest friction of open pairs: those above lose their ties together
TOUCHES = 1e-2  # of the interface's largest force: pairs touch that less than that would close
UNTIED = 5e-2  # the same of pairs that ``ties`` left out, for which those next to them bear it
AGAINST = 3.0  # times all forces that pass, of friction that cancels at the frame's nodes
BEARS = 1e-6  # of the largest force: with less friction it does not matter whether a pair touches
LED_MISS = 1e-8  # of the largest force, that nodes may miss which balance in sums: what holds them
# by less than a hundredth goes 10,000 radii of a ball for 1e-9
BORNE = 2e-2  # of the normal force, friction of open pairs that keep their ties


def lost(s: InterfaceState, multiplier: Array) -> float:
    """Share of an interface's normal force on pairs in contact that do not follow the frame
    tangentially.

    Args:
        s: the interface.
        multiplier: λ (n,) of all [force].
    """
    force, loose = multiplier[s.nodes.rows[:, -1]], s.own.active & ~s.tied
    return float(np.abs(force[loose]).sum() / max(np.abs(force).sum(), 1e-300))


def release(equations: Equations, multiplier: Array, w: Array) -> bool:
    """Whether frame nodes that have balanced in sums miss it; from then on in this load step these
    balance on their own.

    Args:
        equations: of the laws.
        multiplier, w: λ (n,) [force] and w (m,) [length].
    """
    forces = on_frames(equations, multiplier, w)
    missed = np.abs(forces - equations.loads) > LED_MISS * np.abs(multiplier).max(initial=0.0)
    return any([_balance_alone(s, missed[s.nodes.v]) for s in equations.states])


def _balance_alone(s: InterfaceState, missed: Array) -> bool:
    """Frame nodes of an interface that miss their balance, (k d,) by components, balance on their
    own; True: some had not.

    Pairs that opened and closed by turns have their friction again: where one alone presses a
    node, nothing else could balance the friction of others there.
    """
    missed = missed & (np.diff(s.others.frame_relative.indptr) > 0)
    if led := bool(missed.any()):
        alone, known = missed.reshape(len(s.adrift), -1).any(axis=1), s.own.closings.copy()
        s.begin(np.where(alone, 0.0, s.adrift), s.keeps)
        if s.keeps:
            s.own.closings = np.where(known < GONE, known, 0)
            s.touch(s.own.active)
    return led


def count(s: InterfaceState, chosen: Array, wrong: Array, light: Array) -> None:
    """Count how often pairs close; those that close alone, or hardly press, soon do so by turns.

    Args:
        s: the interface.
        chosen: (n,) pairs in contact from now on.
        wrong: (n,) pairs whose sign is wrong.
        light: (n,) pairs that hardly press.
    """
    own, changed = s.own, chosen != s.own.active
    light = light | (changed.sum() <= FEW * len(chosen) + 2)
    own.closings += np.where(chosen & ~own.active, np.where(light, ALONE, 1), 0)
    if s.keeps:  # a sign that is wrong in contact and out of it
        stuck = wrong & ~changed
        own.closings += np.where(stuck, ALONE, 0)
        own.closings[stuck & (own.closings >= BY_TURNS)] = GONE


def keep(states: list[InterfaceState]) -> None:
    """From now on pairs of second order that open and close by turns keep their ties: without them
    too many would have no friction.

    Args:
        states: of the interfaces.
    """
    for s in states:
        s.keeps = s.second
        s.touch(s.own.active)


def lets_go(states: list[InterfaceState], multiplier: Array, gaps: Array, felt: float) -> bool:
    """Change what is not as it should be of friction that has come to rest: pairs that bear it
    without pressing, and nodes that are pulled at; whether there are any.

    Args:
        states: of all interfaces.
        multiplier: λ (n,) [force].
        gaps: (n,) of the rows, times the surfaces' stiffness [force].
        felt: force that is more than rounding [force].
    """
    parted = [_open(s, multiplier, felt) | _part(s, multiplier, gaps, felt) for s in states]
    pulled = [_share_pulls(s, multiplier, felt) for s in states if s.shares and s.nodes.kappa.size]
    return any(parted + pulled)


def _open(s: InterfaceState, multiplier: Array, felt: float) -> bool:
    """Open pairs that touch without pressing and bear friction, if they have not closed often;
    whether there were any. Where bodies have parted the frame may be left with one of them: ties to
    it bear forces that cancel at the frame's nodes."""
    force, own = np.abs(multiplier[s.nodes.rows]), s.own
    idle = own.active & s.tied & ~s.held & (force[:, -1] <= felt) & (own.closings < BY_TURNS)
    idle &= (force[:, :-1] > BEARS * np.abs(multiplier).max(initial=0.0)).any(axis=1)
    if not s.shares or not idle.any():
        return False
    own.closings[idle] += BY_TURNS // 2
    s.touch(own.active & ~idle)
    return True


def _part(s: InterfaceState, multiplier: Array, gaps: Array, felt: float) -> bool:
    """Take their ties from the strongest of those pairs that are open by more than next to nothing
    and bear friction, where they bear too much; whether there were any."""
    if not s.keeps and s.own.ties is None:
        return False
    rows = s.nodes.rows
    open_, pressed = s.tied & ~s.own.active, np.abs(multiplier[rows[:, -1]]).sum()
    bears = np.where(open_, np.linalg.norm(multiplier[rows[:, :-1]], axis=1), 0.0)
    s.grazes = float(bears.sum() / max(pressed, felt)) if bears.sum() > felt else 0.0
    bears[gaps[rows[:, -1]] <= TOUCHES * np.abs(multiplier[rows]).max()] = 0.0
    if bears.sum() <= max(felt, min(BORNE, _allowed(s)) * pressed):
        return False
    gone = bears >= HEAVIEST * bears.max()
    s.own.closings[gone] = GONE
    s.own.ties = None if s.own.ties is None else s.own.ties & ~gone
    s.touch(s.own.active)
    return True


def _share_pulls(s: InterfaceState, multiplier: Array, felt: float) -> bool:
    """Have frame nodes that corrected rows pull at slip as a neighbour does, so that the law holds
    for the sum of both; whether there are new ones."""
    N = s.nodes.L_normal @ multiplier[s.nodes.rows].ravel()
    alone = s.others.speaker == np.arange(len(N))
    pulled = alone & ~s.pulled & (N < -felt)
    s.pulled = s.pulled | pulled
    s.touch(s.own.active)
    return bool(pulled.any())


def too_loose(states: list[InterfaceState], multiplier: Array) -> list[InterfaceState]:
    """Interfaces of which more than the rim of contact has lost its friction.

    Args:
        states: of all interfaces.
        multiplier: λ (n,) of all [force].
    """
    return [s for s in states if lost(s, multiplier) > _allowed(s)]


def _allowed(s: InterfaceState) -> float:
    """Share of the normal force."""
    return FRICTIONLESS if s.own.ties is None else UNTIED


def require_friction(states: list[InterfaceState], multiplier: Array) -> None:
    """Refuse a state in which more than the rim of contact has lost its friction, or friction of
    pairs that slip far exceeds what presses, and cancels where the law holds, or none can pass.

    Args:
        states: of all interfaces.
        multiplier: λ (n,) of all [force].

    Raises:
        ContactError: it has; smaller load steps may help.
    """
    for s in states:
        _require_even(s, multiplier)
    for s in too_loose(states, multiplier):
        raise ContactError(
            f"interface {s.nodes.geometry.interface.name}: pairs that opened and closed by "
            f"turns were left without friction, and carry {lost(s, multiplier):.1%} of the normal "
            f"force (allowed {_allowed(s):.0%}). Apply the load in smaller steps "
            "(solve(increments=...)), or use a finer mesh where contact ends"
        )
    require_sight(states, multiplier)


def _require_even(s: InterfaceState, multiplier: Array) -> None:
    """Refuse friction of single pairs that has nothing to do with what passes, but where it is
    small beside other interfaces; a warning is all then."""
    status = s.own.status
    if not (s.shares and (status == SLIP).any()) or (status == STICK).any():
        return
    force = multiplier[s.nodes.rows]
    friction, pressed = np.linalg.norm(force[:, :-1], axis=1).sum(), np.abs(force[:, -1]).sum()
    shared = (s.others.gather @ (s.nodes.tangential @ force.ravel())).reshape(s.nodes.kappa.shape)
    passes = pressed + 2.0 * np.linalg.norm(shared, axis=1).sum()  # on both sides
    if friction > max(AGAINST * passes, FRICTIONLESS * np.abs(multiplier).max()):
        raise ContactError(
            f"interface {s.nodes.geometry.interface.name}: friction of pairs is "
            f"{friction / passes:.1f} times all forces between the bodies, and cancels at the "
            "frame's nodes, where the law holds: what touches is small beside the frame's cells. "
            "Use smaller cells there on the coarser side"
        )
