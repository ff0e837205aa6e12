"""Which form of the system a problem is solved in, and the system itself."""

from __future__ import annotations

import logging
from typing import Any, Protocol

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.forms.condensed.elimination import EliminatedRows
from dolfinx_llm.forms.condensed.krylov import WIDEST
from dolfinx_llm.forms.condensed.splitting import SplitStiffness
from dolfinx_llm.forms.condensed.steps import CondensedSteps
from dolfinx_llm.forms.condensed.system import CondensedSystem
from dolfinx_llm.forms.exchange import WholeSteps
from dolfinx_llm.forms.flexibility import Flexibility
from dolfinx_llm.forms.saddle import SaddleSystem, SparseSteps
from dolfinx_llm.forms.verdict import Verdict
from dolfinx_llm.operators.bodies import rigid_modes
from dolfinx_llm.operators.petsc import is_symmetric
from dolfinx_llm.operators.system import ContactOperators

log = logging.getLogger("dolfinx_llm")

SOLVERS = ("auto", "saddle", "condensed")
# Unknowns from which on CG + GAMG on the condensed form is faster than a factorisation of (31), as
# measured on two blocks and on two rings.
CROSSOVER = {2: 500_000, 3: 20_000}
FLEXIBLE = 1500  # multipliers up to which contact laws iterate on the surfaces' flexibility


class Stiffness(Protocol):
    """What a form needs to know of the bodies: a part of ``Bulk``."""

    @property
    def K(self) -> PETSc.Mat:
        """PETSc AIJ."""

    def take_K(self) -> PETSc.Mat:
        """K, which the bulk no longer has then."""


def choose_solver(asked: str, K: PETSc.Mat, operators: ContactOperators) -> tuple[str, str]:
    """The form of the system, "saddle", "condensed" or "flexibility", and why.

    Args:
        asked: the user's choice, of ``SOLVERS``.
        K: stiffness of the bodies.
        operators: of the interfaces.

    Raises:
        ContactError: the condensed form was asked for, of a stiffness that is not symmetric.
    """
    symmetric = is_symmetric(K)
    if asked == "condensed" and not symmetric:
        raise ContactError(
            "solver='condensed' needs a symmetric stiffness, and the form a is not symmetric: use "
            "solver='saddle'"
        )
    if not all(model.interface.law.ties for model in operators.models):
        return _choose_steps(asked, symmetric, operators)
    if asked != "auto":
        return asked, "as asked"
    if not symmetric:
        return "saddle", "chosen: the form a is not symmetric"
    limit = CROSSOVER[operators.dofs.gdim]
    if sum(operators.counts.values()) < limit:
        return "saddle", f"chosen: fewer than {limit} unknowns, where factorising is quickest"
    widest = eliminated_rows(operators).widest
    if widest > WIDEST:
        return "saddle", f"chosen: a frame node couples with some {widest:.0f} nodes, too many"
    return "condensed", f"chosen: from {limit} unknowns on CG + GAMG is quicker"


def _choose_steps(asked: str, symmetric: bool, operators: ContactOperators) -> tuple[str, str]:
    """The same for laws that let bodies part or slip, which take several steps."""
    rows, unknowns = operators.counts["lambda"], sum(operators.counts.values())
    if asked == "condensed":
        return "condensed", "as asked"
    if rows <= FLEXIBLE and symmetric:
        first = "as asked, " if asked == "saddle" else ""
        return "flexibility", f"{first}with up to {FLEXIBLE} multipliers the bodies are asked once"
    if asked == "saddle":
        return "saddle", "as asked"
    friction = any(law.slips or law.gives for law in (m.interface.law for m in operators.models))
    limit = CROSSOVER[operators.dofs.gdim]
    if not symmetric or friction or unknowns < limit or eliminated_rows(operators).widest > WIDEST:
        return "saddle", f"chosen: {rows} multipliers, factorised in each step"
    return "condensed", f"chosen: from {limit} unknowns on CG + GAMG is quicker"


def build_system(
    form: str,
    bulk: Stiffness,
    operators: ContactOperators,
    prefix: str,
    options: dict | None,
    times: StageTimes,
) -> SaddleSystem | CondensedSystem:
    """The system of ties in a form, set up.

    Args:
        form: "saddle" or "condensed", which takes K from the bulk.
        bulk: the bodies.
        operators: of the interfaces.
        prefix: of the PETSc options.
        options: PETSc options on top of the form's own.
        times: to which seconds are added.
    """
    if form == "saddle":
        L_b = operators.L_b if operators.L_b.getSize()[1] else None
        with times.timed("factorisation"):
            return SaddleSystem(bulk.K, operators.B, L_b, operators.scale, prefix, options)
    with times.timed("reduction"):
        rows = eliminated_rows(operators)
        split = SplitStiffness(bulk.take_K(), rows.dofs)
        system = CondensedSystem(
            split, rows, operators.dofs.fixed, operators.scale, prefix, options,
            modes=rigid_modes_of(operators),
        )  # fmt: skip
        split.release()
    with times.timed("factorisation"):
        system.set_up()
    return system


def build_steps(
    form: str, bulk: Stiffness, operators: ContactOperators, prefix: str, options: dict | None
) -> Flexibility | WholeSteps:
    """What solves the linear steps of laws that let bodies part or slip; see ``build_system``."""
    rows, B, frames = operators.rows, operators.B, operators.unknowns
    common = operators.bodies, operators.dofs.fixed, operators.scale, prefix, options
    if form == "flexibility":
        return Flexibility(bulk.K, B, rows.numbering, *common)
    if form == "saddle":
        return SparseSteps(bulk.K, B, rows.numbering, frames, *common)
    block, modes = 1, None
    if operators.unknowns.sizes[1] == operators.frames.sizes[1]:  # no jumps
        block, modes = block_size(operators), rigid_modes_of(operators)
    return CondensedSteps(rows, block, modes, bulk.take_K(), B, frames, *common)


def block_size(operators: ContactOperators) -> int:
    """Frame unknowns per node where all frames have as many, else 1."""
    sizes = {model.directions.shape[1] for model in operators.models if len(model.directions)}
    return sizes.pop() if len(sizes) == 1 else 1


def eliminated_rows(operators: ContactOperators) -> EliminatedRows:
    """All multiplier rows, tied to the frames."""
    rows, block = operators.rows, block_size(operators)
    return EliminatedRows(
        rows.dofs, rows.base, operators.L, rows.numbering, operators.frames, block
    )


def rigid_modes_of(operators: ContactOperators) -> tuple[np.ndarray, np.ndarray]:
    """Rigid modes at this rank's dofs of the bodies (n_local, k) and at all frame unknowns (m, k).

    About the middle of the scene and of its size, so that far coordinates cost no digits.
    """
    bodies = operators.bodies
    low, high = bodies.low.min(axis=0), bodies.high.max(axis=0)
    centre, size = 0.5 * (low + high), np.linalg.norm(high - low)
    body = rigid_modes((bodies.points - centre) / size)
    frame = [
        np.einsum("mdi,mik->mdk", model.directions, rigid_modes((model.places - centre) / size))
        for model in operators.models
    ]
    k = body.shape[2]
    return body.reshape(-1, k), np.concatenate(
        [np.empty((0, k)), *(modes.reshape(-1, k) for modes in frame)]
    )


def describe(form: str, system: Any) -> str:
    """A line for ``print(problem)``: the form, the method and what the last solve took."""
    if form == "flexibility":
        words = ["saddle, on the flexibility of the surfaces, K factorised once by MUMPS"]
    elif form == "saddle":
        words = ["saddle, (31) factorised by MUMPS"]
    elif system is None:
        words = ["condensed, symmetric positive definite"]
    else:
        took = f", {system.iterations} iterations" if system.iterations else ""
        words = [f"condensed, {system.method}{took}", *system.notes]
    return "; ".join(words + lost_digits(system))


def lost_digits(system: Any) -> list[str]:
    """What the last solve may have lost to rounding, where that is more than usual."""
    return Verdict(0.0, getattr(system, "rounding", 0.0)).lost


def warn(system: Any, comm: MPI.Comm) -> None:
    """Log what the last solve may have lost to rounding."""
    for words in lost_digits(system):
        if comm.rank == 0:
            log.warning(words)
