"""Which pairs follow a frame along its tangents in a load step, where not those in contact.

The tie of a pair bears any force, however little the pair presses. Where every pair in contact has
one, a pair that hardly presses may pull itself open by its tie, and press again without it: then no
state at all meets the law. Ties are therefore chosen once where these pairs bear more than may be
without friction. Tied are the pairs that press in contact without friction. They stay tied while
the iteration goes on, and the nodes that speak for others, which follow from ties alone, stay as
well. For given ties a state exists, which Newton's method finds in about ten iterations. Open
pairs may then bear friction by their ties; where that is too much, the strongest ones lose their
ties for good, which ends (``flickering``). Later load steps begin with the ties that are left, and
choose anew where they do not come to rest either. Coulomb's law holds at the frame's nodes with the
normal forces of all pairs, tied or not.

Where contact is narrower than a facet hardly any node of the frame would speak for itself: all that
touches would stick or slip as one, and its ties would bear many times what friction may. So nodes
that pairs hold less firmly speak for themselves there (``BY_LITTLE``).
"""

from __future__ import annotations

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.contact.search.flickering import too_loose

SETTLING = 1e-2  # of the largest force, that laws are missed by: contact is nearly what it will be
TIELESS = 1e-2  # of the normal force without friction, on the pairs that press least: no ties

NEVER, NOW, DONE, MORE = range(4)  # whether ties have been asked for, chosen, added to in a step


def unsettled(states: list[InterfaceState]) -> bool:
    """Whether ties are to be chosen now, as has just been asked for.

    Args:
        states: of all interfaces.
    """
    asked = _of(states, NOW)
    for s in asked:
        s.asked = DONE
    return bool(asked)


def ask(states: list[InterfaceState], multiplier: Array, vital: bool) -> bool:
    """Ask for ties once in a load step where all has come to rest, with too many pairs without
    friction on some interfaces; whether there are any. Where friction alone holds bodies contact
    without it would tell nothing: ties are chosen where pairs press that have come to rest.

    Args:
        states: of all interfaces.
        multiplier: λ (n,) [force].
        vital: friction alone holds bodies.
    """
    some = _of(too_loose(states, multiplier), NEVER)
    for s in some:
        s.asked = DONE if vital else NOW
        if vital:
            _tie(s, multiplier)
            s.touch(s.own.active)
    return bool(some)


def ask_again(states: list[InterfaceState]) -> None:
    """Where contact without friction has turned out to tell nothing, what was asked for may be once
    more.

    Args:
        states: of all interfaces.
    """
    for s in _of(states, DONE):
        s.asked = NEVER if s.own.ties is None else DONE


def tie_more(states: list[InterfaceState], multiplier: Array, miss: float) -> bool:
    """Tie what presses now as well, once in a load step, where too much is without a tie, as
    friction has moved contact; whether there is any.

    Args:
        states: of all interfaces.
        multiplier: λ (n,) [force].
        miss: by how much laws are missed, of the largest force.
    """
    chosen = [s for s in _of(states, DONE) if s.own.ties is not None and miss < SETTLING]
    some = too_loose(chosen, multiplier)
    for s in some:
        s.asked = MORE
        _tie(s, multiplier, s.own.ties)
        s.touch(s.own.active)
    return bool(some)


def _of(states: list[InterfaceState], asked: int) -> list[InterfaceState]:
    return [s for s in states if s.asked == asked]


def choose(states: list[InterfaceState], multiplier: Array) -> None:
    """Tie the pairs that press, of what was asked for.

    Args:
        states: of all interfaces.
        multiplier: λ (n,) of contact without friction [force].
    """
    for s in states:
        if s.asked:
            _tie(s, multiplier)
            s.asked = DONE


def _tie(s: InterfaceState, multiplier: Array, kept: Array | None = None) -> None:
    """To the pairs that press, but for the weakest, to those (n,) that are kept, and to those that
    cannot part."""
    force = np.maximum(multiplier[s.nodes.rows[:, -1]], 0.0)
    order = np.argsort(force)
    carried = np.cumsum(force[order])
    s.own.ties = s.stays.copy() if kept is None else kept.copy()
    s.own.ties[order] |= carried > TIELESS * carried[-1]
