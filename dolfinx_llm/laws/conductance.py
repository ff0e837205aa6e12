"""Heat, or the like, across an interface that resists."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.laws.coulomb import Varying
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.rows import CLOSED, LawNodes, LawRows, value_now

CONDUCTS = "give a finite number of at least 0; Tied() is perfect conductance"


@dataclass(frozen=True, eq=False, repr=False)
class Conductance(Law):
    """Of a scalar field u, as a temperature: what flows from side 0 to side 1, per area, is
    q = h (u_0 - u_1), at the frame's nodes. ``Tied()`` is perfect conductance, without a jump.

    Args:
        h: conductance, at least 0 [power / (area temperature)]: a number, a function of positions
            (k, gdim) that returns (k,), a scalar dolfinx Constant, or a scalar Function of one of
            the bodies' meshes. It is asked anew in every solve, so that a function may tell it from
            the pressure of another problem's last one, see ``result.pressure_at``:
            ``lambda x: c * contact.results[0].pressure_at(x)``. Nothing flows where it is 0.

    Raises:
        ContactInputError: h negative or no number.

    >>> Conductance(250.0)
    Conductance(h=250.0)
    """

    h: Varying
    components, opens, gives, closes_gap, scalar = "cartesian", False, True, False, True

    def __post_init__(self) -> None:
        if not callable(h := self._now):
            checks.number("Conductance: h", h, CONDUCTS, low=0.0)

    @property
    def _now(self) -> Any:
        """h, of a Constant its value."""
        return value_now("Conductance: h", self.h, CONDUCTS)

    def __repr__(self) -> str:
        return f"Conductance(h={checks.shown(self.h)})"

    def rows(self, nodes: LawNodes) -> LawRows:
        """T = h area jump, times c / (c + h area), which a large h leaves finite; see ``Law``.

        Args:
            nodes: what is known at the last iterate.

        Raises:
            ContactInputError: h is negative or no number at a node.
        """
        h = np.asarray(nodes.values(self._now), dtype=float)
        if h.shape != (len(nodes.x),) or not ((h >= 0.0) & (h < np.inf)).all():  # NaN as well
            fits = h.shape == (len(nodes.x),)
            told = f"{h.min()} to {h.max()}" if fits else f"shape {h.shape}"
            raise ContactInputError(
                f"Conductance: h at {len(nodes.x)} positions is of {told}: {CONDUCTS} for each"
            )
        k = h * np.maximum(nodes.area, 0.0)
        by_force = (nodes.c / (nodes.c + k))[:, None]
        by_jump = -by_force * k[:, None]
        return LawRows(
            status=np.full(len(h), CLOSED),
            C_T=by_force[:, :, None],
            C_jump=by_jump[:, :, None],
            C_N=np.zeros_like(by_jump),
            rhs=-by_jump * nodes.before,  # the whole jump counts, not that of this step
        )
