"""The state of a problem carried over to another mesh of the same bodies."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import Any

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.contact.state import ContactState
from dolfinx_llm.geometry.spaces import order_of
from dolfinx_llm.interface.against import forced
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.interface.update import remeshed
from dolfinx_llm.laws.coulomb import Coulomb
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.problem.elsewhere import found_elsewhere
from dolfinx_llm.problem.nonlinear import NonlinearContactProblem
from dolfinx_llm.problem.problem import ContactProblem
from dolfinx_llm.problem.state_file import Arrays

SAMPLED = "cohesive", "mu"  # of Coulomb's law: told by positions; mu is, where it is one


def carry_over(old: Any, new: Any) -> None:
    """Go on from the last state of a problem on another mesh of the same bodies; collective.

    Args:
        old, new: as of ``transfer``, problems.

    Raises:
        ContactInputError, ContactError: as ``transfer`` does.
    """
    _check(old, new)
    u = found_elsewhere(old.spaces, new.spaces, [old.u if isinstance(old.u, list) else [old.u]])[0]
    if isinstance(old, NonlinearContactProblem):
        new.bulk.put(u)
        new.reset()
        _stand(old, new)
        return
    new.update()
    new.method.prepare()
    common, operators = _contact(old, new), new.operators
    motions = operators.obstacle_motions()
    common |= {f"motion {i}": motion for i, motion in enumerate(motions)}
    numbering = operators.rows.numbering
    push = times(operators.B, common["multiplier"][numbering.mine])
    common["g"] = operators.gather(numbering, operators.gap(u, motions))
    new.take_arrays(common, {"u": u, "f": times(new.K, u) + push})


def _stand(old: NonlinearContactProblem, new: NonlinearContactProblem) -> None:
    """Put obstacles of a problem to where they stand in the last state of the old one, from where
    slip on them counts."""
    before, (now, local) = old.state_arrays()[0], new.state_arrays()
    for i, interface in enumerate(new.interfaces):
        if interface.obstacle is None:
            continue
        own, pose = f"interface {i} own", f"interface {i} pose"
        now[pose] = before[pose]
        if found := sum(forced(interface.obstacle, new.bulk.dofs.gdim)):  # where forces bring it
            now[own] = np.append(now[own][:-found], before[own][-found:])
    new.take_arrays(now, local)


def _contact(old: ContactProblem, new: ContactProblem) -> Arrays:
    """What interfaces go on from, the same on every rank, but for gaps."""
    kept, _ = old.method.kept()
    iteration = new.method.iteration
    found = {"forces": kept["forces"], "history": np.array(json.dumps(old.method.history))}
    found["loads"] = iteration.equations.frame_loads()
    found["multiplier"] = np.zeros(sum(s.nodes.rows.size for s in new.method.states))
    found["w"] = np.zeros(iteration.equations.m)
    found["reported"] = found["multiplier"].copy()
    every = zip(old.geometries, new.geometries, strict=True)
    for i, (before, now) in enumerate(every):
        change, at = remeshed(before, now)
        state, fresh = (p.method.states[i] for p in (old, new))
        own = state.own.carried(change, fresh.own)
        if isinstance(state.law, Coulomb):
            names = SAMPLED if state.law.dynamic is None else SAMPLED[:1]
            own.history |= {name: fresh.own.history[name] for name in names}
        told = {f.name: getattr(own, f.name) for f in fields(ContactState)}
        law = told.pop("history")
        found |= {f"interface {i} {name}": value for name, value in told.items()}
        found |= {f"interface {i} law {name}": value for name, value in law.items()}
        for name in ("multiplier", "reported"):
            forces = kept[name][state.nodes.rows]
            found[name][fresh.nodes.rows] = _forces(before, now, at, forces)
        place, there = new.operators.places[i], old.operators.places[i]
        v = kept["w"][there.frame].reshape(before.directions.shape[:2])
        if now.frame is not None:
            moved = change.frame @ np.einsum("md,mdg->mg", v, before.directions)
            v = np.einsum("mg,mdg->md", moved, now.directions)
        found["w"][place.frame] = v.ravel()
        jumps = kept["w"][state.nodes.kappa]
        found["w"][fresh.nodes.kappa] = change.turned(jumps) if jumps.size else jumps
    return found


def _forces(
    before: InterfaceGeometry, now: InterfaceGeometry, at: list[Any], forces: np.ndarray
) -> np.ndarray:
    """(n_new, c) multipliers of pairs, with the force per area of the old ones (n_old, c)."""
    found, first = [], 0
    for old, new, N in zip(before.pairs, now.pairs, at, strict=True):
        own = forces[first : first + len(old.nodes)]
        first += len(old.nodes)
        bears = old.forces > 0.0
        area = np.where(bears, old.forces, 1.0)[:, None]
        density = np.einsum("nc,ncg->ng", own, old.base) / area * bears[:, None]
        vectors = (N @ density) * new.forces[:, None]
        found.append(np.einsum("ng,ncg->nc", vectors, new.base))
    return np.concatenate(found)


def _check(old: Any, new: Any) -> None:
    """Require problems between which a state can go over."""
    for name, problem in (("old", old), ("new", new)):
        kinds = (ContactProblem, NonlinearContactProblem)
        checks.instance(name, problem, kinds, "give a ContactProblem or a NonlinearContactProblem")
        linear = isinstance(problem, ContactProblem)
        if linear and any(order_of(V) > 1 for V in problem.spaces):
            raise ContactInputError(
                "transfer: ContactProblems of second-order bodies cannot be carried over yet: a "
                "NonlinearContactProblem of the same bodies can"
            )
        problem.saved_spaces()
    told = [[(type(i.law).__name__, i.obstacle is None) for i in p.interfaces] for p in (old, new)]
    if type(old) is not type(new) or told[0] != told[1] or len(old.spaces) != len(new.spaces):
        raise ContactInputError(
            f"transfer: the old problem, a {type(old).__name__} of {len(old.spaces)} mesh(es) and "
            f"{told[0]}, and the new one, a {type(new).__name__} with {len(new.spaces)} and "
            f"{told[1]}, differ: give the same kind, meshes, laws and obstacles"
        )
    if old.comm.size != new.comm.size:
        raise ContactInputError("transfer: old and new problem live on other numbers of ranks")
    if not old.results and isinstance(old, ContactProblem):
        raise ContactError("transfer: nothing has been solved yet: call old.solve() first")
