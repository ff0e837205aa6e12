"""Contact laws: what the user chooses. The equations they stand for are in ``iteration`` and
``friction``."""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx_llm.base import checks

METHODS = ("newton", "switch")


@dataclass(frozen=True)
class Tied:
    """The bodies stick to each other everywhere (the paper's stick state in the whole domain).

    Args:
        close_gap: close the initial gap between the bodies, which strains them. By default they
            are tied as drawn, free of stress.

    Raises:
        ContactInputError: close_gap is neither True nor False.

    >>> Tied()
    Tied(close_gap=False)
    """

    close_gap: bool = False
    unilateral, friction = False, False

    def __post_init__(self) -> None:
        checks.boolean("Tied: close_gap", self.close_gap)


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
        checks.number("Coulomb: mu", self.mu, "give a finite number of at least 0", low=0.0)
        checks.one_of("Coulomb: method", self.method, METHODS)


LAWS = (Tied, Frictionless, Coulomb)
