"""Ties: no opening, no slip."""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx_llm.base import checks
from dolfinx_llm.laws.law import Law


@dataclass(frozen=True)
class Tied(Law):
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
    components, opens = "cartesian", False

    def __post_init__(self) -> None:
        checks.boolean("Tied: close_gap", self.close_gap)

    @property
    def closes_gap(self) -> bool:  # type: ignore[override]
        """Whether the gap as drawn counts."""
        return self.close_gap
