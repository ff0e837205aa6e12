"""Opening and sliding: normal forces that press."""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx_llm.laws.coulomb import Coulomb
from dolfinx_llm.laws.law import Law


@dataclass(frozen=True)
class Frictionless(Law):
    """The bodies may part and slide: contact forces are normal and press, (12) and (15).

    On each side λ_n >= 0, gap >= 0 and λ_n gap = 0.

    >>> Frictionless().opens, Frictionless().slips
    (True, False)
    """

    components = "normal"


class FreeSlip(Coulomb):
    """The same along curved surfaces of second order: nothing acts along them at the frame's nodes.

    Normals turn along a facet there. What a pressure exerts at a pair is along no one normal, and
    control values of a slip have parts across the surface, of second order in the facets' size:
    pairs bear forces along it which cancel at the frame's nodes, and the frame moves along it. So
    do open pairs: what is solved stays a convex programme, and does not depend on the way there.

    Args:
        follows: False on a frame that supports hold: there pairs of the other side bear nothing
            along it, each by itself.

    >>> FreeSlip(), FreeSlip().slips
    (Frictionless(), True)
    """

    def __init__(self, follows: bool = True) -> None:
        super().__init__(0.0)
        object.__setattr__(self, "slips", True)
        object.__setattr__(self, "components", "local")
        object.__setattr__(self, "shares", False)
        object.__setattr__(self, "follows", follows)

    def __repr__(self) -> str:
        return repr(Frictionless())
