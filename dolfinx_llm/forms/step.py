"""One linear step of contact laws, the forms of (31) that solve it, and the answer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.operators.system import ContactOperators

SIGN = 1e-11  # relative: what rounding may not switch
ROUNDED_GAP = 4.0 * float(np.finfo(float).eps)  # of positions
LEAST_FELT = 3e-11  # of scale times the motion at the start of a load step: no forces are smaller
GRAZING = 1e-3  # forces below this part of scale times motion count as none
SOFT = 1e-6  # compliance, relative to the surface's, with which forces at supports change


@dataclass(frozen=True, eq=False)
class LinearStep:
    """One linear step of contact laws, in the unknowns' own order; the same on every rank.

    K u + B λ = f in the bodies. Rows that are in contact: y - L w - s λ = -g, with y = Bᵀ u and s
    their compliance; the others: λ = 0. Frame rows: E λ + D w = rhs. With ties alone all rows are
    in contact, E = L_bᵀ and D = 0: that is (31). Free bodies: springs, which at a solution carry
    nothing.
    """

    active: Array  # (n,) multiplier rows in contact
    may_open: Array  # (n,) rows of normal forces that may open, or close
    L: csr_matrix  # (n, m) motion of the frame as the rows see it
    g: Array  # (n,) [length]
    compliance: Array  # (n,) by how much rows give way [length / force]; 0: rigid
    E: csr_matrix  # (m, n)
    D: csr_matrix  # (m, m) [force / length]
    rhs: Array  # (m,) [force]
    anchor: Array  # (k,) where springs hold the free motions of ``Floating``
    spring: float  # their stiffness [force / length]
    pins: list[int]  # (p,) this rank's dofs, local numbers, at which they hold
    pull: Array  # (p,) spring times where they hold these [force], part of the load
    about: Array  # (n,) λ about which rows in contact give way, as g has it [force]
    least: float = 0.0  # where all forces are below, they are none [force]
    ties: bool = False  # there is nothing else, which E = Lᵀ and D = 0 follow from

    @classmethod
    def tied(cls, L: csr_matrix, g: Array, E: csr_matrix | None = None) -> LinearStep:
        """All rows hold.

        Args:
            L: (n, m) L_b.
            g: (n,) [length].
            E: (m, n) its transpose, where that is at hand.
        """
        (n, m), nothing = L.shape, np.zeros(0)
        on, D, E = np.ones(n, dtype=bool), csr_matrix((m, m)), L.T.tocsr() if E is None else E
        return cls(
            on, ~on, L, g, np.zeros(n), E, D, np.zeros(m), nothing, 0.0, [], nothing,
            np.zeros(n), ties=True,
        )  # fmt: skip

    def unloaded(self) -> LinearStep:
        """The step without loads, with what is in contact now."""
        names = "may_open", "g", "rhs", "anchor", "pull", "about"
        return replace(self, **{name: np.zeros_like(getattr(self, name)) for name in names})

    def transposed(self) -> LinearStep:
        """The step without loads whose matrix is the transpose of this one's."""
        E, L, D = (M.T.tocsr() for M in (self.L, self.E, self.D))
        return replace(self.unloaded(), L=L, E=E, D=D)

    @cached_property
    def holds(self) -> bool:
        """Whether D does no more than hold each frame unknown by a spring of its own."""
        row = np.repeat(np.arange(self.D.shape[0]), np.diff(self.D.indptr))
        alone = not self.D.data[row != self.D.indices].any()
        return alone and bool((self.D.diagonal() <= 0.0).all())

    @cached_property
    def symmetric(self) -> bool:
        """Whether the frames are in equilibrium, E = Lᵀ, but for such springs."""
        return self.ties or self.holds and (self.E - self.L.T).count_nonzero() == 0

    def same_matrix(self, other: LinearStep) -> bool:
        """Whether another step differs in loads alone: what has been factorised serves it.

        Args:
            other: the step.
        """
        parts = zip((self.L, self.E, self.D), (other.L, other.E, other.D), strict=True)
        return (
            self.spring == other.spring
            and np.array_equal(self.active, other.active)
            and np.array_equal(self.compliance, other.compliance)
            and all(a is b or _same(a, b) for a, b in parts)
        )

    def level(self, multiplier: Array, y: Array, scale: float) -> float:
        """Size of forces; where bodies hardly touch, of a part of those that closing gaps would
        take [force].

        Args:
            multiplier, y: λ and Bᵀ u, (n,).
            scale: stiffness of the surfaces [force / length].
        """
        apart = GRAZING * scale * np.abs(y + self.g).max(initial=0.0)
        return unless_none(max(np.abs(multiplier).max(initial=0.0), apart, 1e-300), self.least)

    def loaded(self, f: Array) -> Array:
        """(n_local,) load with what the springs pull.

        Args:
            f: (n_local,) this rank's load [force].
        """
        f = f.copy()
        f[self.pins] += self.pull
        return f


def _same(a: csr_matrix, b: csr_matrix) -> bool:
    names = "indptr", "indices", "data"
    return a.shape == b.shape and all(
        np.array_equal(getattr(a, name), getattr(b, name)) for name in names
    )


@dataclass(frozen=True, eq=False)
class StepResult:
    """What a linear step leads to, with the pairs that are then in contact; but for u the same on
    every rank. ``StepForm.result`` makes one of u, λ and w."""

    u: Array  # (n_local,) this rank's [length]; empty where ``displacement`` finds it later
    multiplier: Array  # (n,) λ [force]
    y: Array  # (n,) Bᵀ u [length]
    w: Array  # (m,) frame unknowns v, then slips κ [length]
    floating: Array  # (k,) free motions
    active: Array  # (n,) rows in contact
    wrong: Array  # (n,) rows whose sign is still wrong


class StepForm(ABC):
    """A form of (31), which solves the linear steps of contact laws; derive your own.

    ``prepare`` and ``solve`` are all that a form needs. Every call is collective. An object serves
    one problem.

    Attributes:
        name: for ``print(problem)``, messages and ``problem.form``.
        accuracy: of L_bᵀ λ = 0 and of laws of friction, over the largest force, that it reaches.
        proximal: what holds frame nodes that nothing touches, over the surfaces' stiffness. What it
            carries until they are where they touch moves slender bodies.
        light: another matrix costs little beside it.
        noise: rounding of multipliers in the last step, where they are differences [force].
        tolerance: residual of K u + B λ = f that was asked of it, if it is large [force].
        factorised: another load of the last step costs little.
        takes_K: ``prepare`` uses K up; the problem assembles another where it is asked for.
        K: PETSc AIJ stiffness of the bodies, identity rows and columns at prescribed dofs.
        operators: ``ContactOperators``: B and L_b, numbers of rows and unknowns, ``scale``.
    """

    name: str = "own form"
    accuracy: float = 1e-12
    proximal: float = 1e-12
    light: bool = False
    noise: float = 0.0
    tolerance: float = 0.0
    factorised: bool = True
    takes_K: bool = False
    K: PETSc.Mat
    operators: ContactOperators

    def __init__(self) -> None:  # noqa: B027
        """Nothing is known before ``prepare``."""

    def prepare(self, K: PETSc.Mat, operators: ContactOperators) -> None:
        """Take over bodies or interfaces that are new or have changed.

        Args:
            K: stiffness, PETSc AIJ.
            operators: of the interfaces.
        """
        self.K, self.operators = K, operators

    @abstractmethod
    def solve(self, f: Array, step: LinearStep) -> StepResult:
        """One linear step.

        Contact is first taken as ``step.active`` says; where that gives tension or overlap, a form
        may exchange pairs among ``step.may_open`` as far as it can.

        Args:
            f: (n_local,) this rank's load, prescribed values at prescribed dofs [force].
            step: the equations.

        Returns:
            What ``result`` makes of the solution.

        Raises:
            ContactError: it cannot be solved.
        """

    def result(
        self,
        step: LinearStep,
        u: Array,
        multiplier: Array,
        w: Array,
        active: Array | None = None,
    ) -> StepResult:
        """A solution, with what follows from it.

        Args:
            step: that was solved.
            u: (n_local,) this rank's displacement [length].
            multiplier: (n,) λ of all ranks, in the order of ``step`` [force].
            w: (m,) frame and slip unknowns of all ranks [length].
            active: (n,) rows in contact; None: those of the step.
        """
        y, floating = self.motion(u), self.operators.floating.amounts(u)
        active = step.active if active is None else active
        wrong = wrong_signs(step, active, multiplier, y, w, self.operators.scale)
        return StepResult(u, multiplier, y, w, floating, active, wrong)

    def motion(self, u: Array) -> Array:
        """(n,) Bᵀ u on every rank.

        Args:
            u: (n_local,) this rank's displacement [length].
        """
        operators = self.operators
        return operators.gather(operators.rows.numbering, times(operators.B, u, transposed=True))

    def correct(self, found: StepResult) -> None:  # noqa: B027
        """Take out rounding of what was found, before the step is solved again.

        Args:
            found: of the last step.
        """

    def displacement(self, found: StepResult) -> Array:
        """(n_local,) this rank's u of the last step.

        Args:
            found: of that step.
        """
        return found.u

    def left(self, f: Array, u: Array, multiplier: Array) -> Array:
        """(n_local,) K u + B λ - f of the last step.

        Args:
            f: (n_local,) load.
            u: (n_local,) displacement.
            multiplier: (n,) λ.
        """
        operators = self.operators
        forces = times(operators.B, multiplier[operators.rows.numbering.mine])
        return times(self.K, u) + forces - f

    def describe(self) -> str:
        """For ``print(problem)``: the form, and what the last step took."""
        return self.name

    def destroy(self) -> None:  # noqa: B027
        """Free the PETSc objects; ``prepare`` may be called afterwards."""


def wrong_signs(
    step: LinearStep, active: Array, multiplier: Array, y: Array, w: Array, scale: float
) -> Array:
    """(n,) rows with tension in contact or overlap out of it, beyond what rounding can do."""
    position = y + step.g
    gap, band = step.L @ w - position, SIGN * step.level(multiplier, y, scale)
    soft = step.compliance > 0.0  # forces there are gaps, which are rounded, over little
    rounding = (
        ROUNDED_GAP * np.abs(position).max(initial=0.0) / np.where(soft, step.compliance, 1.0)
    )
    pulls = multiplier < -np.where(soft, np.maximum(band, rounding), band)
    # What follows from rows that give way overlaps by as much as these do, until they come to rest.
    gives = step.compliance * np.where(active, np.abs(multiplier - step.about), 0.0)
    overlaps = gap < -np.where(soft, np.maximum(band / scale, gives.sum()), band / scale)
    wrong = np.where(active, pulls, overlaps)
    return wrong & step.may_open


def unless_none(level: float, least: float) -> float:
    """A level of forces; where that is below the least, one to which all of them are rounding.

    Args:
        level, least: [force].

    >>> unless_none(2.0, 1.0), unless_none(0.5, 1.0)
    (2.0, 100000000000.0)
    """
    return level if level > least else max(least / SIGN, level)
