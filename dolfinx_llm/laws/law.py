"""What contact laws have in common: their flags, states of nodes, and linearised rows.

A law holds at k nodes: those of the frame, or the surface's own against a rigid obstacle. Plain
NumPy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

OPEN, STICK, SLIP = 0, 1, 2
CLOSED = 3  # in contact, without friction


class Law:
    """A contact law; the flags say which unknowns and conditions it needs.

    Attributes:
        unilateral: the bodies may part: λ_n >= 0, gap >= 0, λ_n gap = 0.
        friction: there are tangential forces, bounded, and slip.
        close_gap: the initial gap counts.
    """

    unilateral: bool
    friction: bool
    close_gap: bool

    def coefficients(self, x: np.ndarray) -> np.ndarray:
        """(k,) tangential over normal force that nodes bear.

        Args:
            x: (k, gdim) their positions [length].
        """
        return np.zeros(len(x))

    def cohesion_at(self, x: np.ndarray) -> np.ndarray:
        """(k,) tangential traction that nodes bear besides [force / area].

        Args:
            x: (k, gdim) their positions [length].
        """
        return np.zeros(len(x))

    def rows(
        self, T: np.ndarray, bound: np.ndarray, jump: np.ndarray, c: np.ndarray, before: np.ndarray
    ) -> LawRows:
        """The law linearised about the last iterate.

        Args:
            T: (k, t) tangential forces [force].
            bound: (k,) what they may reach; at most 0 where nothing presses [force].
            jump: (k, t) slip of this load step [length].
            c: (k,) positive [force / length]; the solution does not depend on it.
            before: (k,) status in the last iterate.
        """
        raise NotImplementedError

    def miss(self, T: np.ndarray, bound: np.ndarray, jump: np.ndarray, c: np.ndarray) -> np.ndarray:
        """(k,) distance from the law [force].

        Args:
            T: (k, t) tangential forces [force].
            bound: (k,) what they may reach; at most 0 where nothing presses [force].
            jump: (k, t) slip of this load step [length].
            c: (k,) positive [force / length]; the solution does not depend on it.
        """
        raise NotImplementedError


@dataclass(frozen=True, eq=False)
class LawRows:
    """C_T T + C_δ δ + C_N S = rhs at n nodes, d tangents, with S the bound of the forces."""

    status: np.ndarray  # (n,) OPEN, STICK, SLIP
    C_T: np.ndarray  # (n, d, d)
    C_delta: np.ndarray  # (n, d, d) [force / length]
    C_N: np.ndarray  # (n, d)
    rhs: np.ndarray  # (n, d) [force]

    def tied(self, speaker: np.ndarray, unheld: np.ndarray, c: float) -> LawRows:
        """The same, but that nodes for which others speak slip as those do: their δ, taken relative
        to it, vanishes; and that nodes which no force reaches do not slip.

        Args:
            speaker: (n,) of ``speakers``.
            unheld: (n,) of the function of that name.
            c: size of their rows [force / length].
        """
        own = speaker == np.arange(len(speaker))
        kept = (own & ~unheld)[:, None, None]
        unit = np.eye(self.rhs.shape[1])
        return LawRows(
            np.where(unheld, OPEN, self.status[speaker]),
            C_T=np.where(kept, self.C_T, 0.0),
            C_delta=np.where(kept, self.C_delta, c * unit),
            C_N=np.where(kept[:, 0], self.C_N, 0.0),
            rhs=np.where(kept[:, 0], self.rhs, 0.0),
        )
