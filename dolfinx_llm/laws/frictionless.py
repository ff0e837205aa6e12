"""Opening and sliding: normal forces that press."""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx_llm.laws.law import Law


@dataclass(frozen=True)
class Frictionless(Law):
    """The bodies may part and slide: contact forces are normal and press, (12) and (15).

    On each side λ_n >= 0, gap >= 0 and λ_n gap = 0.

    >>> Frictionless().opens, Frictionless().slips
    (True, False)
    """

    components = "normal"
