"""Which pairs follow a frame along its tangents in a load step, where not those in contact.

The tie of a pair bears any force, however little the pair presses. Where every pair in contact has
one, a pair that hardly presses may pull itself open by its tie, and press again without it: then no
state at all meets the law. Where pairs do not come to rest, many of a curved frame or some that
bear more than may be without friction, ties are therefore chosen once, where contact without
friction presses, and stay while the iteration goes on. Of those whose pairs are open and still bear
friction the strongest are let go for good, until there are none: each goes once at most, so that
this ends. Later load steps begin with the ties that are left, and choose anew where they do not
come to rest either. Coulomb's law holds at the frame's nodes with the normal forces of all pairs,
tied or not.

Where contact is narrower than a facet, next to no node of the frame would speak for itself: all
that touches would stick or slip as one, and its ties would bear many times what friction may.
There nodes speak for themselves that pairs hold by less (``BY_LITTLE``), so that friction bounds
what ties bear, more pairs are tied, and who speaks for whom depends on ties alone.
"""

from __future__ import annotations

import numpy as np

from dolfinx_llm.contact.followers import speakers
from dolfinx_llm.contact.loose import too_loose
from dolfinx_llm.contact.state import InterfaceState

EVERY = 12  # iterations with a tie for each pair in contact
RESTLESS = 0.05  # of the pairs: where more change then, they do not come to rest
PRESSES = 2e-2  # of the largest normal force without friction: pairs with more are tied
LITTLE_TIED = 5e-3  # the same where contact is narrower than a facet
SETTLING = 1e-2  # of the largest force, that laws are missed by: from there on ties may go
STRONGEST = 0.5  # of the largest force of friction at an open pair: those above go together

NEVER, NOW, DONE = range(3)  # whether ties have been asked for in this load step


def unsettled(states: list[InterfaceState], changes: int, iteration: int) -> bool:
    """Whether ties are to be chosen now: many pairs of curved frames still change, or it
    has just been asked for.

    Args:
        states: of all interfaces.
        changes: in this iteration.
        iteration: its number.
    """
    many, asked = RESTLESS * sum(len(s.nodes.rows) for s in states), _of(states, NOW)
    for s in asked:
        s.asked = DONE
    late = iteration == EVERY and any(s.curved for s in states)
    return bool(asked) or (late and changes > many)


def ask(states: list[InterfaceState], multiplier: np.ndarray, vital: bool) -> bool:
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


def _of(states: list[InterfaceState], asked: int) -> list[InterfaceState]:
    return [s for s in states if s.asked == asked]


def choose(states: list[InterfaceState], multiplier: np.ndarray, iteration: int) -> None:
    """Tie the pairs that press, of curved frames and of what was asked for, if it is time to.

    Args:
        states: of all interfaces.
        multiplier: λ (n,) of contact without friction [force].
        iteration: its number.
    """
    if iteration <= EVERY:
        return
    for s in states:
        if s.curved or s.asked:
            _tie(s, multiplier)


def _tie(s: InterfaceState, multiplier: np.ndarray) -> None:
    """To the pairs that press."""
    force = multiplier[s.nodes.rows[:, -1]]
    top = force.max(initial=0.0)
    s.ties = force > PRESSES * top
    speak = speakers(s.nodes.of(s.ties))[s.nodes.reached(s.ties)]
    # Fewer nodes speak for all that ties reach than a facet has corners.
    s.narrow = s.curved and len(np.unique(speak)) < s.nodes.x.shape[1]
    s.ties = force > LITTLE_TIED * top if s.narrow else s.ties


def untie(states: list[InterfaceState], multiplier: np.ndarray, miss: float, felt: float) -> bool:
    """Let go of open pairs that bear friction; whether there were any.

    Args:
        states: of all interfaces.
        multiplier: λ (n,) [force].
        miss: by how much laws are missed, of the largest force.
        felt: friction that is more than rounding [force].
    """
    found = False
    for s in states:
        if s.ties is None or miss >= SETTLING:
            continue
        force = np.linalg.norm(multiplier[s.nodes.rows[:, :-1]], axis=1)
        force = np.where(s.ties & ~s.own.active, force, 0.0)
        gone = force > max(felt, STRONGEST * force.max(initial=0.0))
        s.ties = s.ties & ~gone
        s.touch(s.own.active)
        found |= bool(gone.any())
    return found
