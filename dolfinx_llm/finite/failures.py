"""How Newton's iteration fails in an increment, and where."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.iterates import comes_back
from dolfinx_llm.finite.load_step import Equations
from dolfinx_llm.forms.options import NoOption

NO_MOTION = 1e-12  # of a cell: motion in an iteration that is none
WAITS_STILL = 2  # iterations without any, after which there will be none
LEFT_OVER = 1e-6  # relative residual that is not rounding
NOISE_LEFT, WAITS_LOW = 1e-9, 6  # one that is, after so many iterations on end with no larger one
STUCK = 0.9  # part of the last residual above which an iteration has brought nothing
LINGERS = 1e-8  # relative: what laws may be missed by if it stays so, as at supports of both sides
LOWS, LOWER = 3, 0.1  # or is so little so often, and goes no lower
AS_FAR = 10.0  # times as far as bodies are large and driven, by which none comes that is held
FLIES = 1e6  # cells, by which no body moves in an iteration that something holds


class StepFailed(ContactError):
    """Newton's iteration has failed; the text says how. Raised on all ranks together."""


class NothingHolds(StepFailed):
    """No motion balances what is left: smaller increments are hardly of help."""


@contextmanager
def failing() -> Iterator[None]:
    """What cannot be evaluated or solved ends the iteration, not the load step."""
    try:
        yield
    except (NoOption, ContactInputError):  # smaller increments are of no help
        raise
    except (np.linalg.LinAlgError, ContactError) as error:
        raise StepFailed(str(error)) from None


def where(steps: Equations, sizes: Array) -> str:
    """The node, as drawn, with the largest of the sizes (n_local,) of this rank's dofs, and the
    interface next to it; collective."""
    dofs, found = steps.bodies.dofs, (-1.0, list[float]())
    of_nodes = sizes[dofs.of_nodes].reshape(-1, dofs.components).max(axis=1)
    if len(of_nodes):
        largest = int(of_nodes.argmax())
        found = float(of_nodes[largest]), dofs.points[largest].tolist()
    x = np.array(max(dofs.comm.allgather(found))[1])
    text, near = f"at the node drawn at {checks.place(x)}", np.inf
    for placed in steps.interfaces:
        drawn = placed.drawn.reshape(-1, len(x)) + placed.what.sides.surfaces[0].origin
        distance = float(np.linalg.norm(drawn - x, axis=1).min())
        if distance < near:
            near, next_to = distance, f", next to the interface between {placed.what.named}"
    return text + (next_to if np.isfinite(near) else "")


def inside_out(steps: Equations, body: Array, du: Array) -> StepFailed:
    """For a residual (n_local,) that is not finite after the smallest change tried; collective."""
    comm, wrong = steps.bodies.dofs.comm, ~np.isfinite(body)
    every = np.array(comm.allgather((float(wrong.sum()), float(np.abs(du).max(initial=0.0)))))
    return StepFailed(
        f"elements turn inside out: {every[:, 0].sum():.0f} entries of the residual are no finite "
        f"numbers after a change of u by up to {every[:, 1].max():.3g}, the first "
        f"{where(steps, wrong.astype(float))}"
    )


def check_solution(steps: Equations, du: Array, dq: Array) -> float:
    """Require changes of this rank's u (n_local,) and of own unknowns that are numbers, and that of
    u no larger than held bodies move, which is returned; collective."""
    comm = steps.bodies.dofs.comm
    finite = np.isfinite(du).all() and np.isfinite(dq).all()
    if not comm.allreduce(bool(finite), op=MPI.LAND):
        raise StepFailed("the linear solver gives no finite numbers")
    far = comm.allreduce(float(np.abs(du).max(initial=0.0)), op=MPI.MAX)
    if far > FLIES * steps.bodies.size:
        raise StepFailed(
            f"a body flies away, by {far:.2g} in an iteration, {where(steps, np.abs(du))}: "
            "nothing holds it"
        )
    return far


def check_flown(steps: Equations, far: float, driven: float) -> None:
    """Require that bodies have come no farther in an increment than ones that something holds.

    Args:
        steps: what is solved.
        far: how far they have come [length].
        driven: how far supports and obstacles have, but for turns [length]; same on every rank.

    Raises:
        StepFailed: they have. Collective.
    """
    comm, x = steps.bodies.dofs.comm, steps.bodies.dofs.points
    both = np.concatenate([x, -x], axis=1).max(axis=0, initial=-np.inf)
    size = float(np.linalg.norm(np.max(comm.allgather(both), axis=0).reshape(2, -1).sum(axis=0)))
    if not steps.bodies.in_time and far > AS_FAR * (size + driven):
        raise StepFailed(
            f"a body flies away, by {far:.2g}, where what moves it goes {driven:.2g} and all "
            f"bodies together are {size:.2g} large: nothing holds it. Hold it by supports or weak "
            "springs"
        )


def unbalanced(steps: Equations, error: float, left: Array) -> NothingHolds:
    """For a relative residual that no motion balances, of sizes left (n_local,) at this rank's dofs
    [force]; collective."""
    return NothingHolds(
        f"no motion balances forces that are left, residual {error:.1e}, the largest "
        f"{where(steps, left)}: nothing holds a body there"
    )


@dataclass
class Going:
    """Whether iterations still move anything. Where a system is singular, solvers may leave out
    what nothing holds: forces are left then, and further iterations are the same."""

    still: int = 0  # iterations on end in which nothing has moved or changed
    low: int = 0  # iterations on end with a residual of rounding, and no change
    errors: tuple[float, ...] = ()  # of the last iterations
    rest: float = np.inf  # what laws were missed by after the last one
    lows: tuple[float, ...] = ()  # the same after all, where it was little

    @property
    def noise(self) -> float:
        """Relative residual that is none. Rows that are hardly told, as of a tooth's tip on another
        one, are rounded more than forces over stiffness tell."""
        return NOISE_LEFT if self.low >= WAITS_LOW else 0.0

    @property
    def part(self) -> float:
        """Of the next changes, to be applied: half where iterates come back, as across a kink, on
        neither side of which their linear models are equilibria."""
        goes_to_and_fro = comes_back(self.errors, 2) and not comes_back(self.errors, 1)
        return 0.5 if goes_to_and_fro else 1.0

    def lingers(self, rest: float) -> bool:
        """See what laws are missed by after an iteration [relative]: whether it is little, and no
        less than after the last one, or little again and again, as where solves for next to nothing
        go far along what is singular."""
        before, self.rest = self.rest, rest
        if rest >= LINGERS:
            return False
        least, self.lows = min(self.lows, default=np.inf), (*self.lows, rest)
        return rest > STUCK * before or (len(self.lows) >= LOWS and rest > LOWER * least)

    def stopped(self, far: float, changes: int, error: float) -> bool:
        """See another iteration that has not come to rest: whether none will.

        Args:
            far: how far it has moved nodes, over the size of cells.
            changes: pairs that have opened or closed in it.
            error: the relative residual.
        """
        self.errors = (*self.errors[-3:], error)
        self.still = self.still + 1 if far < NO_MOTION and not changes else 0
        self.low = self.low + 1 if error < NOISE_LEFT and not changes else 0
        return self.still >= WAITS_STILL and error > LEFT_OVER
