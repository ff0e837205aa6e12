"""What can be said of a solution of (31): residual, balance, rounding; one message for each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_llm.base.errors import ContactError

EPS = np.finfo(float).eps
UNBALANCED = (
    1e-8  # of the forces' size: residual of K u + B λ = f, pull of springs that hold bodies
)
SEVERAL = 64.0  # rounding errors of stiffness times displacement that a residual may consist of
NOTABLE = 1e-9  # of the forces, that rounding may change without a word
DRIFTED = 1e-8  # of the displacements, the same
LOST = 1e-4  # of the forces, that rounding may change before they are refused


class FinalError(ContactError):
    """What no smaller load step helps."""


@dataclass(frozen=True)
class Verdict:
    """Of a solution of K u + B λ = f."""

    residual: float  # over the size of forces
    rounding: float  # error of the forces that no solver can avoid, over their size
    drift: float = 0.0  # the same of rigid motions that weak springs hold, over the motion's size

    @property
    def lost(self) -> list[str]:
        """What may have been lost to rounding, where that is more than usual."""
        words = []
        if self.rounding > NOTABLE:
            words.append(
                f"forces may be off by {self.rounding:.0e}, by rounding alone: stiffness times "
                "displacement is that much larger than the loads. A stiff body hangs on a soft "
                "one (hold it by a support or a spring), or cells are slivers"
            )
        if self.drift > DRIFTED:
            words.append(
                f"displacements may be off by {self.drift:.0e} of their size: springs hold a body "
                "that weakly against the rounding of its own stiffness, and contact does not "
                "hold it there. Hold it by a support or a stiffer spring"
            )
        return words


def rounding_error(
    comm: Any, diagonal: np.ndarray, u: np.ndarray, f: Any, multiplier: Any
) -> float:
    """Relative error of the forces that rounding alone may cause, whatever the solver.

    A stiff body that hangs on a soft one moves far: the forces in it are differences of terms of
    the size K_ii u_i, and their rounding is not small against the loads.

    Args:
        comm: MPI communicator.
        diagonal: this rank's diagonal of K.
        u, f, multiplier: this rank's displacements, loads and multipliers.
    """
    free = (diagonal != 1.0) | (np.abs(u - f) > 1e-12 * np.abs(u))  # not an identity row
    largest = [
        np.abs(diagonal * u)[free].max(initial=0.0),
        max(np.abs(f)[free].max(initial=0.0), np.abs(multiplier).max(initial=0.0)),
    ]
    terms, forces = np.max(comm.allgather(largest), axis=0)
    return float(EPS * terms / forces) if forces > 0.0 else 0.0


def require(found: tuple[float, float], allowed: tuple[float, float], how: str) -> None:
    """Require small residuals of (31), over the size of the unknowns and over the load's.

    Raises:
        ContactError: they are not.
    """
    if not (found[0] < allowed[0] and found[1] < allowed[1]):
        raise ContactError(
            f"the solve failed: residual {found[0]:.1e} of the unknowns' size (allowed "
            f"{allowed[0]:.0e}), {found[1]:.1e} of the load's (allowed {allowed[1]:.0e}); {how}. "
            "Check supports, material data and the petsc_options given"
        )


def check_rounding(rounding: float) -> None:
    """Refuse forces of which rounding leaves too little.

    Args:
        rounding: as of ``rounding_error``.

    Raises:
        FinalError: more than ``LOST``.
    """
    if rounding > LOST:
        raise FinalError(
            f"rounding alone may change the forces by {rounding:.0e} of their size (allowed "
            f"{LOST:.0e}): stiffness times displacement is {rounding / EPS:.0e} times the forces. "
            "A stiff body hangs on a soft one, or on weak springs: hold it by a support or a "
            "stiffer spring, or cells are slivers"
        )


def judge(comm: Any, miss: np.ndarray, terms: np.ndarray, forces: float, what: str) -> Verdict:
    """Accept a solution of K u + B λ = f, or say why not.

    Args:
        comm: MPI communicator.
        miss: this rank's K u + B λ - f [force].
        terms: this rank's |K_ii u_i| [force].
        forces: size of the forces.
        what: how it was solved, for the message.

    Raises:
        ContactError: a residual that is not small, or forces that are lost in rounding.
    """
    sizes = [np.abs(miss).max(initial=0.0), np.abs(terms).max(initial=0.0)]
    left, largest = np.max(comm.allgather(sizes), axis=0)
    forces = max(forces, 1e-300)
    residual, rounding = left / forces, EPS * largest / forces
    if left <= max(UNBALANCED * forces, SEVERAL * EPS * largest):
        check_rounding(rounding)
        return Verdict(float(residual), float(rounding))
    raise ContactError(
        f"the solve failed: {residual:.1e} of the forces' size is left (allowed {UNBALANCED:.0e}; "
        f"rounding explains {rounding:.0e}), by {what}. Check supports, material data and the "
        "petsc_options given"
    )
