"""One increment of a load step by Newton's iteration with an active set."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import collective, told
from dolfinx_llm.finite.failures import STUCK, check_solution, failing, inside_out
from dolfinx_llm.finite.falling import add_springs, caught, falling, flight
from dolfinx_llm.finite.linear.parts import Part
from dolfinx_llm.finite.load_step import (
    Equations,
    LoadStep,
    NewtonState,
    chosen_at,
    missed_at,
    slid,
    stays,
    with_shared,
)
from dolfinx_llm.finite.settling import (
    EXCHANGES,
    Exchanges,
    foreseen,
    lands,
    opened_or_closed,
)
from dolfinx_llm.finite.turning import with_what_turns
from dolfinx_llm.finite.two_obstacles import Doubled
from dolfinx_llm.laws.rows import OPEN

CONVERGED = 1e-11  # residual over the largest force, and gap over the size of facets
ROUNDED = 4e-15  # residual over stiffness times length: stresses near 1 + grad u = 1 are rounded
NO_GAP = 1e-11  # gap over facet size that is none
DOUBTS = 1e-3  # pull over the largest force, below the residual, that parts no pair
SLIDES = 0.5  # of a facet, in an iteration, up to which derivatives of rows and areas hold
TRUSTED = 0.03  # residual, relative, below which slip has its exact derivative
TELLING = 0.3  # residual, relative, up to which the linear model tells which pairs touch at first
LANDED = 1e-5  # residual, relative, below which solves leave next to nothing
HELPED, LESS = 0.5, 0.1  # where it has not brought the residual down by as much: only below a tenth
DAMPS = 1e-2  # of the stiffness: springs of damped iterations where all of a force is left
CUTS = 8  # of a change that turns elements inside out


def _push(total: Array, at: Array, force: Array) -> None:
    """Add forces known to every rank to those on this rank's dofs (n_local,)."""
    mine = (at >= 0) & (at < len(total))
    np.add.at(total, at[mine], force[mine])


class Increment:
    """Newton's iteration from a state to a part of a load step.

    The first solve lets nodes slide far beyond their facets, where derivatives of rows and covered
    areas say nothing: they count once an iteration slides by less than half a facet, or finer
    meshes take more iterations. Until then the linear model says which pairs touch, and where
    iterates open or close some, which they do for ever where far off.

    Args:
        steps, step: what is solved, and the load step.
        good: the state that it starts from.
        end: the part of it, in (0, 1].
        draws: those pairs touch that meet first where nothing does and contact is not known yet,
            or bodies that nothing else holds would fall; else ``undrawn`` tells of such ones.
    """

    def __init__(
        self, steps: Equations, good: NewtonState, step: LoadStep, end: float, draws: bool = True
    ) -> None:
        self.steps, self.end, self.draws = steps, end, draws
        self.dofs, self.fixed, start = steps.bodies.dofs, steps.bodies.dofs.fixed, step.start
        self.target = start.u + end * (step.values - start.u)
        self.pressures = start.pressures + end * (step.pressures - start.pressures)
        self.unbalanced = (1.0 - end) * step.unbalanced
        self.poses = [a + end * (b - a) for a, b in zip(start.poses, step.poses, strict=True)]
        turned = with_what_turns(steps, good, self.target, self.poses)
        self.turned, good = turned is not None, turned or good
        self.u, self.own = good.u.copy(), [q.copy() for q in good.own]
        self.lagged, self.trusted = True, TRUSTED
        with failing():
            self.held, self.faces = chosen_at(steps, good, self.poses)
        self.status: list[Any] = list(good.status)
        self.stays, self.known = stays(steps, start), all(s is not None for s in good.status)
        self.doubled = Doubled(self.dofs.comm, steps.interfaces, NO_GAP * steps.size)
        self.changes, self.doubt, self.stuck, self.error, self.rest = 0, 0.0, False, np.inf, np.inf
        self.drawn, self.undrawn = [False] * len(self.held), False
        self.touched = [s is not None and bool(s.any()) for s in good.status]
        self._body = self._residual(self.u)
        self.evaluate()

    def _residual(self, u: Array) -> Array:
        with self.steps.times.timed("assembly of F"):
            return self.steps.bodies.residual(u)

    def evaluate(self) -> None:
        """Contact, loads and residual at the displacement as it is."""
        before = self.error
        with self.steps.times.timed("contact"), failing():
            self._contact()
        self.balance()
        self.stuck = self.error > STUCK * before

    def balance(self) -> None:
        """Residual for the forces of contact and loads as they are."""
        steps, comm, largest = self.steps, self.dofs.comm, 0.0
        r = self._body - self.unbalanced
        self.loads, self.pushed = list[Part](), np.zeros_like(r)
        for placed, p, faces in zip(steps.followers, self.pressures, self.faces, strict=True):
            z = placed.at(self.dofs, self.u)
            with failing(), collective(comm):
                force, K = placed.what.terms(z, p, faces, self.lagged)
            self.loads.append(Part(K, placed.numbers, placed.numbers))
            _push(self.pushed, placed.numbers - self.dofs.first, force)
            largest = max(largest, np.abs(force).max(initial=0.0))
        for placed, t in zip(steps.interfaces, self.terms, strict=True):
            _push(self.pushed, placed.numbers - self.dofs.first, placed.at_dofs(t.force))
            largest = max(largest, np.abs(t.force).max(initial=0.0))
        r -= self.pushed
        parts = r[self.fixed], self.unbalanced, r[~self.fixed], self.u
        mine = [float(np.abs(part).max(initial=0.0)) for part in parts]
        mine.append(max([np.abs(t.rest).max(initial=0.0) for t in self.terms], default=0.0))
        mine += [max([0.0, *(t.miss for t in self.terms)]), largest]  # the same but for rounding
        reaction, load, rest, moved, gap, miss, largest = np.max(comm.allgather(mine), axis=0)
        largest = max(largest, reaction, load, 1e-12 * steps.scale * steps.size, 1e-300)
        size = max(largest, ROUNDED / CONVERGED * steps.scale * (steps.bodies.size + moved))
        self.r, self.off, missed = r, float(rest / size), float(miss / size)
        self.error, self.rest = max(self.off, missed), max(gap / steps.size, missed)
        self.doubt = min(max(rest, miss), DOUBTS * largest)

    def _contact(self) -> None:
        """Terms of the interfaces, with the status that their pairs have now."""
        places, starts, status, found, asks = (list[Any]() for _ in range(5))
        every, size, comm = self.steps.interfaces, self.steps.size, self.dofs.comm
        bounds = max(NO_GAP * size, self.doubt / self.steps.scale), NO_GAP * size  # closed, open
        for i, (placed, before, q) in enumerate(zip(every, self.status, self.own, strict=True)):
            near, z = self.error < self.trusted, placed.at(self.dofs, self.u)
            held = replace(self.held[i], lagged=self.lagged, near=near)
            with collective(comm):
                place = placed.what.place(z, q, held)
                start = np.full(len(place.gap), OPEN) if before is None else before
                reach = _reach(place, start, *bounds)
                now, held = placed.what.touching(place, q, start, held, reach)
            places, starts = [*places, place], [*starts, start]
            status, found = [*status, now], [*found, held]
            apart = not (now.any() or self.steps.bodies.in_time or self.drawn[i])
            lost = before is None or (self.stuck and not start.any())
            asks.append(bool(apart and lost and place.pairs.any()))
        falls = falling(self.dofs, every, status, told(comm, asks), self.touched)
        known = [now is not None for now in self.status]
        self.undrawn |= not self.draws and not all(known[i] for i in falls)
        falls = [i for i in falls if known[i] or self.draws]
        reaches = flight(self, falls, places, status, found)
        for i in falls:
            self.drawn[i] = known[i]  # once: springs may hold it, and pairs pull
            of = places[i], self.own[i], starts[i], found[i], reaches[i]
            with collective(comm):
                status[i], found[i] = every[i].what.touching(*of)
        for i, placed in enumerate(every):
            status[i] = placed.what.staying(self.stays[i] & places[i].pairs, status[i])
        status = self.doubled.once(status, starts, places)
        self.changes = opened_or_closed(status, starts)
        self.take(places, status, found)

    def take(self, places: list[Any], status: list[Any], held: list[Any]) -> None:
        """Terms of the interfaces for pairs with a status."""
        every, self.status = self.steps.interfaces, status
        held = [replace(h, pairs=place.pairs) for h, place in zip(held, places, strict=True)]
        self.held = with_shared(every, held, status)
        of_each = zip(every, places, self.own, status, self.held, strict=True)
        with collective(self.dofs.comm):
            self.terms = [placed.what.terms(*of, placed.free) for placed, *of in of_each]

    def iterate(self, K: PETSc.Mat | None, most: float = 1.0) -> None:
        """Solve for changes, and apply them as far as elements do not turn inside out.

        Args:
            K: the bodies' tangent where it is known, destroyed here.
            most: part of the changes that is applied at most.
        """
        steps, comm = self.steps, self.dofs.comm
        if K is None:
            with steps.times.timed("assembly of J"):
                K = steps.bodies.tangent(self.u)
        try:
            _hold(self, K)
            du, changes = self._solve(K)
            exchanges = Exchanges()
            tells = self.lagged or (self.changes and (self.known or self.error < TELLING))
            for _ in range(EXCHANGES if tells else 0):
                if not _foresee(self, du, changes, exchanges):
                    break
                self.balance()
                du, changes = self._solve(K)
        finally:
            K.destroy()
        for cut in most * 0.5 ** np.arange(CUTS):
            body = self._residual(self.u + cut * du)
            if comm.allreduce(bool(np.isfinite(body).all()), op=MPI.LAND):
                break
        else:
            raise inside_out(steps, body, cut * du)
        self.lagged = told(comm, slid(steps, self.terms, cut * du) > SLIDES * steps.size)
        self.u, self._body = self.u + cut * du, body
        self.own = [q + cut * d for q, d in zip(self.own, changes, strict=True)]
        exact, before = any(held.exact for held in self.held), self.error
        self.evaluate()
        self.stuck &= before > CONVERGED  # a step starts in balance where supports alone move
        early = exact and self.error > HELPED * before  # slip has turned round
        self.trusted *= LESS if early else 1.0

    def _solve(self, K: PETSc.Mat) -> tuple[Array, list[Array]]:
        """Changes of this rank's u and of each interface's own unknowns."""
        du, dq = self.solved(K, (self.lagged or self.error > LANDED) and lands(self.held))
        # How far the iteration moves nodes [length].
        self.far = check_solution(self.steps, du, np.concatenate([np.zeros(0), *dq]))
        return du, dq

    def solved(self, K: PETSc.Mat, exact: bool) -> tuple[Array, list[Array]]:
        """The same, however far they go."""
        steps, r = self.steps, np.where(self.fixed, self.u - self.target, self.r)
        with steps.times.timed("factorisation"), failing():
            du, dq = steps.system.solve(K, self.terms, self.loads, r, self.u, self.error, exact)
        return du, np.split(dq, np.cumsum([len(q) for q in self.own])[:-1]) if self.own else []

    def converged(self, noise: float = 0.0, lingers: bool = False) -> bool:
        """Whether pairs that can touch are in equilibrium, but for noise and what lingers."""
        arrived = np.abs(self.u - self.target)[self.fixed].max(initial=0.0)
        arrived = self.dofs.comm.allreduce(float(arrived), op=MPI.MAX)
        rests = arrived < CONVERGED * self.steps.size and self.off < max(CONVERGED, noise)
        rests &= self.rest < CONVERGED or lingers
        return rests and not self.changes and not self._missed()

    def _missed(self) -> bool:
        """Take in facets that have passed the frame, leave out nodes off it, and cover as now."""
        places = [t.place for t in self.terms]
        with failing():
            found = missed_at(self.steps, self.u, places, self.status, self.held, self.faces)
        if found:
            self.evaluate()
            self.stuck = False  # it has been in balance
        return found


def _reach(place: Any, start: Array, closed: float, opened: float) -> Array:
    """(n,) gaps up to which pairs touch that bear nothing. Those that the linear model has closed
    are judged by their forces: what gap is left is what it does not know, as of a way along a
    tangent of what is round, and far more than soft pressure closes.

    Args:
        place: of the pairs.
        start: (n,) their status in the model.
        closed, opened: gaps that are none, of pairs that were [length].
    """
    left = np.where(place.pairs, np.maximum(closed, place.gap), closed)
    return np.where(start != OPEN, left, opened)


def _hold(run: Increment, K: PETSc.Mat) -> None:
    """Add springs that hold bodies where they are, if there are any."""
    if run.steps.springs is not None:
        add_springs(K, run.steps.springs)
    if run.steps.damped:
        springs = np.zeros(len(run.u))
        springs[run.dofs.of_nodes] = DAMPS * min(1.0, run.error) * run.steps.scale
        add_springs(K, np.where(run.fixed, 0.0, springs))


def _foresee(run: Increment, du: Array, changes: list[Array], exchanges: Exchanges) -> bool:
    """Whether the linear model has other pairs in contact than were put in; these are then. A
    body that comes down on a few nodes alone would bear all of its load on them."""
    every, now = run.steps.interfaces, list(run.status)
    dz = [placed.values(run.dofs, du) for placed in every]
    places = [t.place for t in run.terms]
    for i, (t, q, held) in enumerate(zip(run.terms, run.own, run.held, strict=True)):
        if every[i].what.settles:
            of = every[i].what, t, q, (dz[i], changes[i]), held
            there, places[i] = foreseen(*of, NO_GAP * run.steps.size)
            now[i] = every[i].what.staying(run.stays[i] & t.place.pairs, there)
    now = run.doubled.once(now, run.status, places)
    found = caught(run, now) or exchanges.take(now, run.status, run.held)
    for i, status in found.items():
        q, held = run.own[i], replace(run.held[i], about=(dz[i], run.own[i] + changes[i]))
        of_pairs = run.terms[i].place, q, status, held, every[i].free
        with collective(run.dofs.comm):
            run.status[i], run.terms[i] = status, every[i].what.terms(*of_pairs)
    return bool(found)
