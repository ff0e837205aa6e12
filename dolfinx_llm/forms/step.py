"""One linear step of a contact law, as its iteration hands it to a solver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix

SIGN = 1e-11  # relative: what rounding may not switch
GRAZING = 1e-3  # forces below this part of scale times motion count as none
SOFT = 1e-11  # compliance, relative to the surface's, that makes forces at supports unique


@dataclass(frozen=True, eq=False)
class InterfaceSystem:
    """One linear step of a contact law, in the unknowns' own order; the same on every rank.

    Rows that are in contact: y - L w = -g; the others: λ = 0. Frame rows: E λ + D w = rhs.
    """

    active: np.ndarray  # (n,) multiplier rows in contact
    L: csr_matrix  # (n, m) motion of the frame as the rows see it
    g: np.ndarray  # (n,) [length]
    E: csr_matrix  # (m, n)
    D: csr_matrix  # (m, m) [force / length]
    rhs: np.ndarray  # (m,) [force]


def wrong_signs(step: InterfaceSystem, may_open, multiplier, y, w, scale: float) -> np.ndarray:
    """(n,) rows with tension in contact or overlap out of it, beyond what rounding can do."""
    gap = step.L @ w - y - step.g
    band = SIGN * force_level(multiplier, y + step.g, scale)
    wrong = np.where(step.active, multiplier < -band, scale * gap < -band)
    return wrong & may_open


def force_level(multiplier: np.ndarray, position: np.ndarray, scale: float) -> float:
    """Size of forces; where bodies hardly touch, of a part of those that closing gaps would take
    [force]."""
    apart = GRAZING * scale * np.abs(position).max(initial=0.0)
    return max(np.abs(multiplier).max(initial=0.0), apart, 1e-300)
