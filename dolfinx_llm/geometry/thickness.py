"""Thickness of bodies in the plane, by which areas count: of a sheet, or 2 pi r about an axis.

Forms of such bodies carry it, and so do the forces that a pressure exerts, ∫ N_p t ds. With 2 pi r
in the place of t all that is said of bodies in the plane holds for axisymmetric ones.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError

LINEAR = 1e-9  # of the largest thickness: by how much it may be off a linear function
THICKNESS = "give a positive number, or a function of positions (n, 2) that returns (n,)"


def check_thickness(given: Any) -> None:
    """Require a positive number, a function, or None."""
    if given is not None and (hasattr(given, "ufl_shape") or not callable(given)):
        checks.number("thickness", given, THICKNESS, above=0.0)


def check_all_have(given: Iterable[tuple[str, Any]]) -> None:
    """Require of interfaces and pressures of one problem, (name, thickness), that all have a
    thickness or none: it is the bodies', and a pressure on one by length, on another by area.

    Raises:
        ContactInputError: some have, some have not.
    """
    told = list(given)
    without = [name for name, thickness in told if thickness is None]
    having = [name for name, thickness in told if thickness is not None]
    if without and having:
        raise ContactInputError(
            f"{without[0]} has no thickness, {having[0]} has one; {len(without)} of "
            f"{len(told)} have none: areas, and so pressures, would count by length there. Give "
            "each its own; thickness=1.0 where it is 1"
        )


def thickness_at(given: Any, x: Array) -> Array | None:
    """(n,) at positions (n, gdim), not negative [length]; None where it is 1.

    Raises:
        ContactInputError: values that are no numbers; bodies in space, which have none.
    """
    if given is None or (not callable(given) and given == 1.0):
        return None
    if x.shape[1] != 2:
        raise ContactInputError(
            f"thickness={checks.shown(given)}: it is of bodies in the plane, leave it out in space"
        )
    found = _values(given, x) if callable(given) else np.full(len(x), float(given))
    return np.maximum(found, 0.0)


def check_along(name: str, thickness: Array | None, x: Array, facets: Array) -> None:
    """Require of a thickness (n,) at nodes x (n, 2), if it is not 1, that facets have some, and
    that it is linear in the positions: both sides then have the same between their nodes.

    Raises:
        ContactInputError: it is not.
    """
    if thickness is None:
        return
    at = np.column_stack([np.ones(len(x)), x - x.mean(axis=0)])
    fit = at @ np.linalg.lstsq(at, thickness, rcond=None)[0]
    off, most = np.abs(fit - thickness).max(), thickness.max()
    none = ~(thickness[facets] > 0.0).any(axis=1)
    if none.any():
        middle = x[facets[none]].mean(axis=1)
        raise ContactInputError(
            f"{name} is not positive on {int(none.sum())} facet(s), the first at "
            f"{checks.place(middle[0])}: a function of positions must return the bodies' thickness "
            "there, 0 at most on an axis"
        )
    if off > LINEAR * most:
        raise ContactInputError(
            f"{name} is off a linear function of the positions by {off:.3g}: give one that is "
            "a + b x + c y, as 2 pi r is"
        )


def slope_at(given: Any, x: Array, h: float) -> Array:
    """(n, 2) slopes of a thickness that varies, by differences over h, exact where it is linear."""
    slopes = [_values(given, x + h * e) - _values(given, x - h * e) for e in np.eye(2)]
    return np.column_stack(slopes) / (2.0 * h)


def _values(given: Any, x: Array) -> Array:
    """(n,) that a function returns."""
    return checks.array("thickness: values", given(x), (len(x),), THICKNESS)
