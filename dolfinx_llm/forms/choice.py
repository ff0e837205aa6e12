"""Which form of the system a problem is solved in, and the system itself."""

from __future__ import annotations

import logging

import numpy as np

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.forms.condensed.elimination import SlavedRows
from dolfinx_llm.forms.condensed.krylov import WIDEST
from dolfinx_llm.forms.condensed.splitting import SplitStiffness
from dolfinx_llm.forms.condensed.steps import CondensedSteps
from dolfinx_llm.forms.condensed.system import CondensedSystem
from dolfinx_llm.forms.flexibility import Flexibility
from dolfinx_llm.forms.saddle import SaddleSystem, SparseSteps
from dolfinx_llm.forms.verdict import Verdict
from dolfinx_llm.operators.bodies import rigid_modes
from dolfinx_llm.operators.numbering import slip_numbering
from dolfinx_llm.operators.petsc import is_symmetric

log = logging.getLogger("dolfinx_llm")

SOLVERS = ("auto", "saddle", "condensed")
# Unknowns from which on CG + GAMG on the condensed form is faster than a factorisation of (31), as
# measured on two blocks and on two rings.
CROSSOVER = {2: 500_000, 3: 20_000}
FLEXIBLE = 1500  # multipliers up to which contact laws iterate on the surfaces' flexibility


def choose_solver(problem) -> tuple[str, str]:
    """The form for a ContactProblem, "saddle" or "condensed", and why.

    Raises:
        ContactError: the condensed form was asked for, of a stiffness that is not symmetric.
    """
    symmetric = is_symmetric(problem.K)
    if problem.solver == "condensed" and not symmetric:
        raise ContactError(
            "solver='condensed' needs a symmetric stiffness, and the form a is not symmetric: use "
            "solver='saddle'"
        )
    if any(model.interface.law.unilateral for model in problem.models):
        return _choose_steps(problem, symmetric)
    if problem.solver != "auto":
        return problem.solver, "as asked"
    if not symmetric:
        return "saddle", "chosen: the form a is not symmetric"
    limit = CROSSOVER[problem.spaces[0].mesh.geometry.dim]
    if sum(problem.unknowns.values()) < limit:
        return "saddle", f"chosen: fewer than {limit} unknowns, where factorising is quickest"
    widest = slaved_rows(problem).widest
    if widest > WIDEST:
        return "saddle", f"chosen: a frame node couples with some {widest:.0f} nodes, too many"
    return "condensed", f"chosen: from {limit} unknowns on CG + GAMG is quicker"


def _choose_steps(problem, symmetric: bool) -> tuple[str, str]:
    """The same for laws that let bodies part or slip, which take several steps."""
    rows, unknowns = problem.unknowns["lambda"], sum(problem.unknowns.values())
    if problem.solver == "condensed":
        return "condensed", "as asked"
    if rows <= FLEXIBLE and symmetric:
        asked = "as asked, " if problem.solver == "saddle" else ""
        return "flexibility", f"{asked}with up to {FLEXIBLE} multipliers the bodies are asked once"
    if problem.solver == "saddle":
        return "saddle", "as asked"
    friction = any(model.interface.law.friction for model in problem.models)
    limit = CROSSOVER[problem.spaces[0].mesh.geometry.dim]
    if not symmetric or friction or unknowns < limit or slaved_rows(problem).widest > WIDEST:
        return "saddle", f"chosen: {rows} multipliers, factorised in each step"
    return "condensed", f"chosen: from {limit} unknowns on CG + GAMG is quicker"


def build_system(problem):
    """The system of a ContactProblem in the form that was chosen, set up."""
    common = problem._prefix, problem._options
    if problem.form == "saddle":
        L_b = problem.L_b if problem.L_b.getSize()[1] else None
        with problem._timed("factorisation"):
            return SaddleSystem(problem.K, problem.B, L_b, problem.scale, *common)
    with problem._timed("reduction"):
        rows = slaved_rows(problem)
        split = SplitStiffness(problem._take_K(), rows.dofs)
        system = CondensedSystem(
            split, rows, problem._fixed, problem.scale, *common, modes=rigid_modes_of(problem)
        )
        split.release()
    with problem._timed("factorisation"):
        system.set_up()
    return system


def build_steps(problem):
    """What solves the linear steps of laws that let bodies part or slip."""
    rows, frames = problem._rows, slip_numbering(problem.models, problem._frame_unknowns)
    common = problem.bodies, problem._fixed, problem.scale, problem._prefix, problem._options
    if problem.form == "flexibility":
        return Flexibility(problem.K, problem.B, rows.numbering, *common, soft=problem._soft)
    if problem.form == "saddle":
        numbers = rows.numbering, frames
        return SparseSteps(problem.K, problem.B, *numbers, *common, soft=problem._soft)
    block, modes = 1, None
    if not any(model.interface.law.friction for model in problem.models):
        block, modes = block_size(problem), rigid_modes_of(problem)
    return CondensedSteps(rows, block, modes, problem._take_K(), problem.B, frames, *common)


def block_size(problem) -> int:
    """Frame unknowns per node where all frames have as many, else 1."""
    sizes = {model.directions.shape[1] for model in problem.models if model.frame is not None}
    return sizes.pop() if len(sizes) == 1 else 1


def slaved_rows(problem) -> SlavedRows:
    """All multiplier rows, tied to the frames."""
    return SlavedRows(
        problem._rows.dofs,
        problem._rows.base,
        problem._L_all,
        problem._rows.numbering,
        problem._frame_unknowns,
        block_size(problem),
    )


def rigid_modes_of(problem) -> tuple[np.ndarray, np.ndarray]:
    """Rigid modes at this rank's dofs of the bodies (n_local, k) and at all frame unknowns (m, k).

    About the middle of the scene and of its size, so that far coordinates cost no digits.
    """
    low, high = problem.bodies.low.min(axis=0), problem.bodies.high.max(axis=0)
    centre, size = 0.5 * (low + high), np.linalg.norm(high - low)
    body = rigid_modes((problem.bodies.points - centre) / size)
    frame = [
        np.einsum("mdi,mik->mdk", model.directions, rigid_modes((model.frame.x - centre) / size))
        for model in problem.models
        if model.frame is not None
    ]
    k = body.shape[2]
    return body.reshape(-1, k), np.concatenate(
        [np.empty((0, k)), *(modes.reshape(-1, k) for modes in frame)]
    )


def describe(form: str, system) -> str:
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


def lost_digits(system) -> list[str]:
    """What the last solve may have lost to rounding, where that is more than usual."""
    return Verdict(0.0, getattr(system, "rounding", 0.0)).lost


def warn(problem) -> None:
    """Log what the last solve may have lost to rounding."""
    for words in lost_digits(problem._system):
        if problem.comm.rank == 0:
            log.warning(words)
