"""Which form of (31) a problem is solved in, and why."""

import os
from typing import Any

from petsc4py import PETSc

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.forms.cost import Cost, Scene, costs
from dolfinx_llm.forms.flexibility import Flexibility
from dolfinx_llm.forms.saddle import SaddleForm
from dolfinx_llm.forms.step import StepForm
from dolfinx_llm.operators.petsc import is_symmetric
from dolfinx_llm.operators.system import ContactOperators

SOLVERS = ("auto", "saddle", "condensed")
MOTIONS = 300  # of bodies that contact alone holds, up to which CG can take all of them out
ONE_BODY = 6  # the same with friction: where it holds more, contact goes back and forth by GMRES
FLEXIBLE = 1500  # multipliers up to which contact laws may iterate on the surfaces' flexibility


def form_named(
    name: str, prefix: str, options: dict[str, Any] | None, times: StageTimes
) -> StepForm:
    """The form of a name that ``choose_solver`` returned."""
    if name == "condensed":
        from dolfinx_llm.forms.condensed.steps import CondensedForm  # much that few problems need

        return CondensedForm(prefix, options, times)
    return (Flexibility if name == "flexibility" else SaddleForm)(prefix, options, times)


def choose_solver(
    asked: str | StepForm, K: PETSc.Mat, operators: ContactOperators, steps: int
) -> tuple[str | StepForm, str]:
    """The form of the system, "saddle", "condensed", "flexibility" or the user's, and why, the same
    on every rank; ``steps`` are expected. The condensed one is refused for a stiffness that is not
    symmetric."""
    if isinstance(asked, StepForm):
        return asked, "as given"
    symmetric = is_symmetric(K, operators.diagonal)
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
    if asked == "auto":
        return _by_cost(symmetric, operators, steps)
    if asked == "saddle" and symmetric and _asks(operators):
        return "flexibility", f"as asked, with up to {FLEXIBLE} multipliers bodies are asked once"
    return asked, "as asked"


def other_form(form: str | StepForm, K: PETSc.Mat, operators: ContactOperators) -> str:
    """The form to go on with where contact comes to no rest in one, as pairs change in another
    order there; "" where none serves or fits into memory. Collective."""
    others = {"saddle": "flexibility", "condensed": "flexibility", "flexibility": "condensed"}
    other = others.get(form, "") if isinstance(form, str) else ""
    if not other or operators.dofs.mixed or not _asks(operators):
        return ""
    if not is_symmetric(K, operators.diagonal):
        return ""
    needed = costs(Scene.of(operators))[other].gigabytes
    return other if needed <= operators.comm.allreduce(_memory(), op=min) else ""


def _by_cost(symmetric: bool, operators: ContactOperators, steps: int) -> tuple[str, str]:
    """The form of least work of those that serve and fit into memory, with what all cost."""
    scene = Scene.of(operators, steps)
    found = costs(scene)
    if not (symmetric and _asks(operators)):
        found.pop("flexibility", None)
    no = "the form a is not symmetric" if not symmetric else _no_multigrid(operators)
    ample = operators.comm.allreduce(_memory(), op=min)
    if not no and _least(found, ample) == "condensed":
        no = _too_wide(operators)
    if no:
        del found["condensed"]
    return _least(found, ample), _told(found, ample, no, scene)


def _least(found: dict[str, Cost], ample: float) -> str:
    """Of what takes no more than so many gigabytes, or of all."""
    fits = {name: cost for name, cost in found.items() if cost.gigabytes <= ample} or found
    return min(fits, key=lambda name: fits[name].seconds)


def _told(found: dict[str, Cost], ample: float, no: str, scene: Scene) -> str:
    """For ``print(problem)``: what has been weighed."""
    tight = any(cost.gigabytes > ample for cost in found.values())
    why = "least work of what fits into memory" if tight else "least work"
    each = "; ".join(f"{name} {cost}" for name, cost in found.items())
    if no:
        each += f"; no multigrid: {no}"
    return f"chosen: {why}, about, in {scene.steps} load steps on {scene.ranks} rank(s): {each}"


def _memory() -> float:
    """Gigabytes of this machine."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9


def _asks(operators: ContactOperators) -> bool:
    """Whether there are contact laws, of so few multipliers that bodies may be asked for each."""
    laws = [geometry.interface.law for geometry in operators.geometries]
    few = operators.counts["lambda"] <= FLEXIBLE
    return few and any(law.opens or law.slips for law in laws)


def _no_multigrid(operators: ContactOperators) -> str:
    """Why the condensed form does not serve where it is not asked for, if there is a reason."""
    laws = [geometry.interface.law for geometry in operators.geometries]
    obstacles = [geometry.interface.obstacle for geometry in operators.geometries]
    if any(obstacle is not None and obstacle.everywhere for obstacle in obstacles):
        # CG takes some ten times the iterations.
        return "a mean couples all nodes of its surface"
    if operators.tied:
        return ""
    if any(law.follows for law in laws):
        # Ten times the work of the factorised form: GMRES takes hundreds of iterations.
        return "contact along curved surfaces of second order goes back and forth"
    most = ONE_BODY if any(law.slips or law.gives for law in laws) else MOTIONS
    motions = operators.floating.rigid.modes.shape[1]
    return f"contact alone holds {motions} motions of bodies" if motions > most else ""


def _too_wide(operators: ContactOperators) -> str:
    """The same for rows that are too long for PETSc's GAMG."""
    from dolfinx_llm.forms.condensed.elimination import widest
    from dolfinx_llm.forms.condensed.krylov import WIDEST

    nodes = widest(operators.L, operators.dofs.gdim)
    return f"a frame node couples with some {nodes:.0f} nodes, too many" if nodes > WIDEST else ""
