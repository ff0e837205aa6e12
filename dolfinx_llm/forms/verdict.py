"""What can be said of a solution of (31): residual, balance, rounding; one message for each."""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError

EPS = float(np.finfo(float).eps)
UNBALANCED = (
    1e-8  # of the forces' size: residual of K u + B λ = f, pull of springs that hold bodies
)
SEVERAL = 64.0  # rounding errors of stiffness times displacement that a residual may consist of
NOTABLE = 1e-9  # of the forces, that rounding may change without a word
DRIFTED = 1e-8  # of the displacements, the same
LOST = 1e-4  # of the forces, that rounding or a loose solver may change before they are refused


class FinalError(ContactError):
    """What no smaller load step helps."""


@dataclass(frozen=True)
class Verdict:
    """Of a solution of K u + B λ = f."""

    residual: float  # over the size of forces
    rounding: float  # error of the forces that no solver can avoid, over their size
    felt: float = 0.0  # the same of contact forces, over the largest of these, as it was measured
    drift: float = 0.0  # the same of rigid motions that weak springs hold, over the motion's size
    neutral: str = ""  # words for a motion that contact leaves open

    @property
    def loose(self) -> bool:
        """Whether more is left than the package's own options leave, or rounding explains."""
        return self.residual > max(UNBALANCED, SEVERAL * self.rounding)

    @property
    def lost(self) -> list[str]:
        """What is not unique, and what may have been lost to rounding, if more than usual."""
        words = [self.neutral] if self.neutral else []
        if self.loose:
            words.append(
                f"forces may be off by {self.residual:.0e} of their size, as petsc_options let the "
                "solver stop there: leave ksp_rtol out, or give less"
            )
        if self.rounding > NOTABLE:
            words.append(
                f"forces may be off by {self.rounding:.0e}, by rounding alone: stiffness times "
                "displacement is that much larger than the loads. A stiff body hangs on a soft "
                "one (hold it by a support or a spring), or cells are slivers"
            )
        elif self.felt > UNBALANCED:
            words.append(
                f"contact forces may be off by {self.felt:.0e} of the largest, by rounding, which "
                "slender bodies, or a stiff one beside a soft one, amplify"
            )
        if self.drift > DRIFTED:
            words.append(
                f"displacements may be off by {self.drift:.0e} of their size: springs hold a body "
                "that weakly against the rounding of its own stiffness, and contact does not "
                "hold it there. Hold it by a support or a stiffer spring"
            )
        return words


def size(values: Array) -> float:
    """Largest absolute value; 0 of none."""
    return float(np.abs(values).max(initial=0.0))


def largest(comm: MPI.Comm, *values: Array) -> list[float]:
    """Largest sizes of this and all other ranks' values; collective."""
    return [float(a) for a in np.max(comm.allgather([size(a) for a in values]), axis=0)]


def beyond(value: float, terms: float) -> float:
    """What of a value the rounding of its terms, of this size, does not explain."""
    return max(value - SEVERAL * EPS * terms, 0.0)


class Imprecise(ContactError):
    """A solution of (31) of which the form that has solved it has lost some digits."""


def judge(left: float, terms: float, forces: float, what: str, tolerance: float = 0.0) -> Verdict:
    """Accept a solution of (31), or say why not.

    A stiff body that hangs on a soft one moves far: the forces in it are differences of terms of
    the size K_ii u_i, and their rounding, which no solver avoids, is not small against the loads.

    Args:
        left: what the rows of (31) leave, as force: K u + B λ - f of the free dofs, and more.
        terms: largest |K_ii u_i| of the free dofs [force].
        forces: size of the forces.
        what: how it was solved, for the message.
        tolerance: what the user's choice of a solver may leave [force].
    """
    forces = max(forces, 1e-300)
    residual, rounding = left / forces, EPS * terms / forces
    if left <= max(UNBALANCED * forces, SEVERAL * EPS * terms, tolerance):
        return Verdict(residual, rounding)
    raise (Imprecise if residual < LOST else ContactError)(
        f"the solve failed: {residual:.1e} of the forces' size is left (allowed {UNBALANCED:.0e}; "
        f"rounding explains {rounding:.0e}), by {what}. Check supports, material data and the "
        "petsc_options given"
    )


def check_lost(verdict: Verdict) -> None:
    """Refuse forces of which rounding or a solver that stops early leaves too little."""
    residual, rounding = verdict.residual, verdict.rounding
    if verdict.loose and residual > LOST:
        raise FinalError(
            f"{residual:.1e} of the forces' size is left (allowed {LOST:.0e}), as petsc_options "
            "let the solver stop there: leave ksp_rtol out, or give less"
        )
    if rounding > LOST:
        raise FinalError(
            f"rounding alone may change the forces by {rounding:.0e} of their size (allowed "
            f"{LOST:.0e}): stiffness times displacement is {rounding / EPS:.0e} times the forces. "
            "A stiff body hangs on a soft one, or on weak springs: hold it by a support or a "
            "stiffer spring, or cells are slivers"
        )


def singular(reason: object) -> ContactError:
    """The error of a step whose equations do not determine all forces."""
    return ContactError(
        f"a step of the contact law is singular ({reason}): the forces of some pairs in contact "
        "are not determined. A body loses all contact: hold it by a weak spring or a support; or "
        "supports hold both sides at the interface: leave the motion of one of them free there"
    )
