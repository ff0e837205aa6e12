"""Contact laws."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Tied:
    """The bodies stick to each other everywhere (the paper's stick state in the whole domain).

    Args:
        close_gap: close the initial gap between the bodies, which strains them. By default they
            are tied as drawn, free of stress.
    """

    close_gap: bool = False
