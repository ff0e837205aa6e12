"""One linear step of a contact law, as its iteration hands it to a form of (31), and the answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.forms.floating import Floating

SIGN = 1e-11  # relative: what rounding may not switch
GRAZING = 1e-3  # forces below this part of scale times motion count as none
SOFT = 1e-11  # compliance, relative to the surface's, that makes forces at supports unique


@dataclass(frozen=True, eq=False)
class LinearStep:
    """One linear step of a contact law, in the unknowns' own order; the same on every rank.

    Rows that are in contact: y - L w - s λ = -g, with s their compliance; the others: λ = 0. Frame
    rows: E λ + D w = rhs. Free bodies: springs, which at a solution carry nothing.
    """

    active: np.ndarray  # (n,) multiplier rows in contact
    may_open: np.ndarray  # (n,) rows of normal forces that may open, or close
    L: csr_matrix  # (n, m) motion of the frame as the rows see it
    g: np.ndarray  # (n,) [length]
    compliance: np.ndarray  # (n,) by how much rows give way [length / force]; 0: rigid
    E: csr_matrix  # (m, n)
    D: csr_matrix  # (m, m) [force / length]
    rhs: np.ndarray  # (m,) [force]
    anchor: np.ndarray  # (k,) where springs hold the free motions of ``Floating``
    spring: float  # their stiffness [force / length]


@dataclass(frozen=True, eq=False)
class StepResult:
    """What a linear step leads to, with the pairs that are then in contact; on every rank."""

    multiplier: np.ndarray  # (n,) λ [force]
    y: np.ndarray  # (n,) Bᵀ u [length]
    w: np.ndarray  # (m,) [length]
    floating: np.ndarray  # (k,) free motions
    active: np.ndarray  # (n,) rows in contact
    wrong: np.ndarray  # (n,) rows whose sign is still wrong


class Displacement(NamedTuple):
    """u at this rank's dofs, and what is said of it; zero at prescribed dofs but u."""

    u: np.ndarray
    left: np.ndarray  # K u + B λ - f [force]
    terms: np.ndarray  # K_ii u_i [force]
    load: np.ndarray  # f [force]


class StepForm(Protocol):
    """A form of (31) in which the steps of contact laws are solved; collective."""

    comm: MPI.Comm
    name: str  # for messages
    proximal: float  # what holds frame nodes that nothing touches, of the surfaces' stiffness
    accuracy: float  # of L_bᵀ λ and the law of friction, over the largest force
    noise: float  # of forces, by rounding [force]
    floating: Floating

    def solve(self, f: np.ndarray, step: LinearStep) -> StepResult:
        """One linear step for this rank's loads f (n_local,), prescribed values at fixed dofs.

        Contact is first taken as ``step.active`` says; where that gives tension or overlap, the
        form may exchange pairs among ``step.may_open`` as far as it can.
        """

    def correct(self, found: StepResult) -> None:
        """Take out rounding of what was found, before the step is solved again."""

    def displacement(self, found: StepResult) -> Displacement:
        """Of the last step that was solved."""

    def destroy(self) -> None:
        """Free the PETSc objects."""


def wrong_signs(
    step: LinearStep, multiplier: np.ndarray, y: np.ndarray, w: np.ndarray, scale: float
) -> np.ndarray:
    """(n,) rows with tension in contact or overlap out of it, beyond what rounding can do."""
    gap = step.L @ w - y - step.g
    band = SIGN * force_level(multiplier, y + step.g, scale)
    wrong = np.where(step.active, multiplier < -band, scale * gap < -band)
    return wrong & step.may_open


def singular(reason: object) -> ContactError:
    """The error of a step whose equations do not determine all forces."""
    return ContactError(
        f"a step of the contact law is singular ({reason}): the forces of some pairs in contact "
        "are not determined. A body loses all contact: hold it by a weak spring or a support; or "
        "supports hold both sides at the interface: leave the motion of one of them free there"
    )


def force_level(multiplier: np.ndarray, position: np.ndarray, scale: float) -> float:
    """Size of forces; where bodies hardly touch, of a part of those that closing gaps would take
    [force]."""
    apart = GRAZING * scale * np.abs(position).max(initial=0.0)
    return max(np.abs(multiplier).max(initial=0.0), apart, 1e-300)
