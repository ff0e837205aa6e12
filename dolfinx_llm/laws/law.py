"""Contact laws: what the user chooses. The equations they stand for are in ``iteration`` and
``friction``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_llm.base.errors import ContactInputError

METHODS = ("newton", "switch")


@dataclass(frozen=True)
class Tied:
    """The bodies stick to each other everywhere (the paper's stick state in the whole domain).

    Args:
        close_gap: close the initial gap between the bodies, which strains them. By default they
            are tied as drawn, free of stress.

    >>> Tied()
    Tied(close_gap=False)
    """

    close_gap: bool = False
    unilateral, friction = False, False


@dataclass(frozen=True)
class Frictionless:
    """The bodies may part and slide: contact forces are normal and press, (12) and (15).

    On each side λ_n >= 0, gap >= 0 and λ_n gap = 0.

    >>> Frictionless().unilateral, Frictionless().friction
    (True, False)
    """

    unilateral, friction, close_gap = True, False, True


@dataclass(frozen=True)
class Coulomb:
    """The bodies may part, stick, and slip under friction, (11)-(17).

    Args:
        mu: coefficient of friction, at least 0; 0 leaves out all that friction needs.
        method: "newton": semismooth Newton on the projection form; "switch": the paper's own
            switch between stick and slip with the direction of the last iterate (16), (17), which
            settles gross sliding, and does not settle first slip where directions turn.

    Raises:
        ContactInputError: mu negative or not finite, unknown method.

    >>> Coulomb(0.3)
    Coulomb(mu=0.3, method='newton')
    >>> Coulomb(0.0).friction
    False
    """

    mu: float
    method: str = "newton"
    unilateral, close_gap = True, True

    @property
    def friction(self) -> bool:
        """Whether there are tangential forces at all."""
        return self.mu > 0.0

    def __post_init__(self) -> None:
        try:
            good = np.isfinite(self.mu) and self.mu >= 0.0
        except TypeError:
            good = False
        if not good:
            raise ContactInputError(f"Coulomb(mu={self.mu!r}): give a number of at least 0")
        if self.method not in METHODS:
            raise ContactInputError(f"Coulomb(method={self.method!r}): choose one of {METHODS}")


LAWS = (Tied, Frictionless, Coulomb)
