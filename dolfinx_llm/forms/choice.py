"""Which form of (31) a problem is solved in, and why."""

from collections.abc import Callable

from petsc4py import PETSc

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.forms.condensed.elimination import widest
from dolfinx_llm.forms.condensed.krylov import WIDEST
from dolfinx_llm.forms.condensed.steps import CondensedForm
from dolfinx_llm.forms.flexibility import Flexibility
from dolfinx_llm.forms.saddle import SaddleForm
from dolfinx_llm.forms.step import StepForm
from dolfinx_llm.operators.petsc import is_symmetric
from dolfinx_llm.operators.system import ContactOperators

SOLVERS = ("auto", "saddle", "condensed")
# Unknowns from which on CG + GAMG on the condensed form is faster than a factorisation of (31), as
# measured on two blocks and on two rings.
CROSSOVER = {2: 500_000, 3: 20_000}
ASKING = 3e4  # multipliers times the root of unknowns, to which that is quicker than multigrid
MOTIONS = 300  # of bodies that contact alone holds, up to which CG can take all of them out
FLEXIBLE = 1500  # multipliers up to which contact laws iterate on the surfaces' flexibility
# Seconds of the first load step in 3D on one core, as measured on two blocks of bricks of 8e3 to
# 1.5e5 unknowns: times multipliers and unknowns^(4/3), and times unknowns.
FLEXIBILITY_COST, CONDENSED_COST = 7.6e-9, 1e-4
FORMS: dict[str, Callable[[str, dict | None, StageTimes], StepForm]] = {
    form.name: form for form in (SaddleForm, Flexibility, CondensedForm)
}


def choose_solver(
    asked: str | StepForm, K: PETSc.Mat, operators: ContactOperators
) -> tuple[str | StepForm, str]:
    """The form of the system, "saddle", "condensed", "flexibility" or the user's, and why. The
    condensed one is refused for a stiffness that is not symmetric."""
    if isinstance(asked, StepForm):
        return asked, "as given"
    symmetric = is_symmetric(K)
    if asked == "condensed" and not symmetric:
        raise ContactError(
            "solver='condensed' needs a symmetric stiffness, and the form a is not symmetric: use "
            "solver='saddle'"
        )
    if operators.dofs.mixed:
        if asked == "condensed":
            raise ContactError(
                "solver='condensed' needs a positive definite stiffness, which that of a mixed "
                "function space is not in general: use solver='saddle'"
            )
        asked = "saddle"
    if not operators.tied:
        form, why = _choose_steps(asked, symmetric, operators)
        return form, why + _estimate(operators)
    if asked != "auto":
        return asked, "as asked"
    if not symmetric:
        return "saddle", "chosen: the form a is not symmetric"
    if _means(operators):
        return "saddle", "chosen: a mean couples all nodes of its surface"
    limit = CROSSOVER[operators.dofs.gdim]
    if sum(operators.counts.values()) < limit:
        return "saddle", f"chosen: fewer than {limit} unknowns, where factorising is quickest"
    nodes = widest(operators.L, operators.dofs.gdim)
    if nodes > WIDEST:
        return "saddle", f"chosen: a frame node couples with some {nodes:.0f} nodes, too many"
    return "condensed", f"chosen: from {limit} unknowns on CG + GAMG is quicker"


def _choose_steps(asked: str, symmetric: bool, operators: ContactOperators) -> tuple[str, str]:
    """The same for laws that let bodies part or slip, which take several steps."""
    rows, unknowns = operators.counts["lambda"], sum(operators.counts.values())
    if asked == "condensed":
        return "condensed", "as asked"
    limit, few = CROSSOVER[operators.dofs.gdim], rows <= FLEXIBLE and symmetric
    cheap = operators.dofs.gdim == 2 or rows * unknowns ** (1 / 3) <= ASKING
    condensed = asked == "auto" and unknowns >= limit and symmetric and _iterates(operators)
    laws = [geometry.interface.law for geometry in operators.geometries]
    if not (condensed or any(law.opens or law.slips for law in laws)):
        return "saddle", "chosen: nothing opens or slips, so that one factorisation serves"
    if few and (cheap or not condensed):
        first = "as asked, " if asked == "saddle" else ""
        return "flexibility", f"{first}with up to {FLEXIBLE} multipliers the bodies are asked once"
    if condensed:
        return "condensed", f"chosen: from {limit} unknowns on multigrid is quicker"
    if asked == "saddle":
        return "saddle", "as asked"
    return "saddle", f"chosen: {rows} multipliers, factorised in each step"


def _estimate(operators: ContactOperators) -> str:
    """What the first load step costs in either form, for ``print(problem)``; in 2D, where both are
    cheap, nothing."""
    if operators.dofs.gdim == 2:
        return ""
    rows, unknowns = operators.counts["lambda"], operators.counts["u"]
    flexibility = FLEXIBILITY_COST * rows * unknowns ** (4 / 3)
    condensed = CONDENSED_COST * unknowns
    return (
        f"; first load step on one core about {flexibility:.1g} s by flexibility, "
        f"{condensed:.1g} s condensed"
    )


def _iterates(operators: ContactOperators) -> bool:
    """Whether contact laws of any size are solved by multigrid in the condensed form."""
    laws = [geometry.interface.law for geometry in operators.geometries]
    friction = any(law.slips or law.gives for law in laws)
    floats = operators.floating.rigid.modes.shape[1]
    narrow = widest(operators.L, operators.dofs.gdim) <= WIDEST
    return narrow and not _means(operators) and floats <= (0 if friction else MOTIONS)


def _means(operators: ContactOperators) -> bool:
    """Whether the mean displacement of a surface is prescribed, with which CG takes some ten times
    the iterations."""
    obstacles = [geometry.interface.obstacle for geometry in operators.geometries]
    return any(obstacle is not None and obstacle.everywhere for obstacle in obstacles)
