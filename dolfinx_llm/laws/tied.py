"""Ties: no opening, no slip."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from dolfinx_llm.base import checks
from dolfinx_llm.laws.law import Law


@dataclass(frozen=True, repr=False)
class Tied(Law):
    """The bodies stick to each other everywhere (the paper's stick state in the whole domain).

    Args:
        close_gap: close the initial gap between the bodies, which strains them. By default they
            are tied as drawn, free of stress.
        gap: by which the surfaces move apart along their normal [length]; negative: into each
            other, as a bolt that is tightened is shortened where it is cut. A number, or a scalar
            dolfinx Constant, whose value may change between load steps.

    Raises:
        ContactInputError: close_gap is neither True nor False, gap is no finite number.

    >>> Tied(), Tied(gap=-0.1)
    (Tied(close_gap=False), Tied(close_gap=False, gap=-0.1))
    """

    close_gap: bool = False
    gap: Any = 0.0
    closes_gap: bool = field(init=False, default=False)  # whether the gap as drawn counts
    components, opens = "cartesian", False

    def __post_init__(self) -> None:
        checks.boolean("Tied: close_gap", self.close_gap)
        self.given_gap  # noqa: B018 - refused where it is none
        object.__setattr__(self, "closes_gap", self.close_gap)

    def __repr__(self) -> str:
        gap = f", gap={self.given_gap:.12g}" if self.given_gap else ""
        return f"Tied(close_gap={self.close_gap}{gap})"

    @property
    def given_gap(self) -> float:
        """The gap as it is now [length].

        Raises:
            ContactInputError: it is no finite number.
        """
        value = getattr(self.gap, "value", self.gap)
        return checks.number("Tied: gap", value, "give a finite number, or a scalar Constant")
