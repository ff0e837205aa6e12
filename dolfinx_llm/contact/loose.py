"""Pairs that opened and closed by turns, and were left without friction of their own."""

from __future__ import annotations

import numpy as np

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.contact.state import InterfaceState

FRICTIONLESS = 1e-2  # of the normal force that may be without friction: less than meshes cost
UNTIED = 5e-2  # the same of pairs that ``ties`` left out, for which those next to them bear it


def lost(s: InterfaceState, multiplier: np.ndarray) -> float:
    """Share of an interface's normal force on such pairs.

    Args:
        s: the interface.
        multiplier: λ (n,) of all [force].
    """
    return s.loose_share([multiplier[s.nodes.rows[:, -1]]])


def regain(states: list[InterfaceState], multiplier: np.ndarray) -> bool:
    """Friction again for interfaces of which more than may be is without; whether there are any.

    Once all else has come to rest most of these pairs come to rest with it.

    Args:
        states: of all interfaces.
        multiplier: λ (n,) of all [force].
    """
    some = [s for s in states if s.ties is None and lost(s, multiplier) > FRICTIONLESS]
    for s in some:
        s.begin()
    return bool(some)


def too_loose(states: list[InterfaceState], multiplier: np.ndarray) -> list[InterfaceState]:
    """Interfaces of which more than the rim of contact has lost its friction.

    Args:
        states: of all interfaces.
        multiplier: λ (n,) of all [force].
    """
    return [s for s in states if lost(s, multiplier) > _allowed(s)]


def _allowed(s: InterfaceState) -> float:
    """Share of the normal force."""
    return FRICTIONLESS if s.ties is None else UNTIED


def require_friction(states: list[InterfaceState], multiplier: np.ndarray) -> None:
    """Refuse a state in which more than the rim of contact has lost its friction.

    Args:
        states: of all interfaces.
        multiplier: λ (n,) of all [force].

    Raises:
        ContactError: it has; smaller load steps may help.
    """
    for s in too_loose(states, multiplier):
        raise ContactError(
            f"interface {s.nodes.geometry.interface.name}: pairs that opened and closed by "
            f"turns were left without friction, and carry {lost(s, multiplier):.1%} of the normal "
            f"force (allowed {_allowed(s):.0%}). Apply the load in smaller steps "
            "(solve(increments=...)), or use a finer mesh where contact ends"
        )
