"""Contact of a linear problem where a load step has ended, to go on from with other pairs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.contact.equations.state import ContactState
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.interface.update import remeshed
from dolfinx_llm.operators.petsc import times
from dolfinx_llm.problem.state_file import Arrays


@dataclass(frozen=True, eq=False)
class Standing:
    """What interfaces go on from, the same on every rank, but for gaps."""

    kept: Arrays
    history: Sequence[dict[str, Any]]
    states: Sequence[Any]  # per interface ``InterfaceState``
    geometries: Sequence[InterfaceGeometry]
    places: Sequence[Any]  # where their unknowns stand
    u: Array  # (n_local,) this rank's displacement [length]

    @classmethod
    def of(cls, problem: Any) -> Standing | None:
        """Of a ``ContactProblem``; None: nothing has been solved."""
        method, iteration = problem.method, problem.method.iteration
        if iteration is None or iteration.multiplier is None:
            return None
        common, local = method.kept()
        of_interfaces = method.states, problem.geometries, problem.operators.places
        return cls(common, method.history, *of_interfaces, local["u"])

    def at_pairs_of(self, geometries: Sequence[InterfaceGeometry]) -> bool:
        """Whether pairs and frames are those of other geometries, drawn at the same places."""
        every = zip(self.geometries, geometries, strict=True)
        return all(_told(a) == _told(b) for a, b in every)

    def go_on(self, problem: Any, u: Array) -> None:
        """Let a ``ContactProblem`` of the same interfaces, as drawn, go on from here; collective.

        Args:
            problem: which has other pairs, or other frames.
            u: (n_local,) the displacement there, on its mesh.
        """
        problem.method.prepare()
        common, operators = self._on(problem), problem.operators
        motions = operators.obstacle_motions()
        common |= {f"motion {i}": motion for i, motion in enumerate(motions)}
        numbering = operators.rows.numbering
        push = times(operators.B, common["multiplier"][numbering.mine])
        common["g"] = operators.gather(numbering, operators.gap(u, motions))
        problem.take_arrays(common, {"u": u, "f": times(problem.K, u) + push})

    def _on(self, problem: Any) -> Arrays:
        """The same for the pairs of a problem."""
        method = problem.method
        found = {"sizes": self.kept["sizes"], "history": np.array(json.dumps(self.history))}
        found["loads"] = method.iteration.equations.frame_loads()
        found["multiplier"] = np.zeros(sum(s.nodes.rows.size for s in method.states))
        found["w"] = np.zeros(method.iteration.equations.m)
        found["reported"] = found["multiplier"].copy()
        every = zip(self.geometries, problem.geometries, strict=True)
        for i, (before, now) in enumerate(every):
            change, at = remeshed(before, now)
            state, fresh = self.states[i], method.states[i]
            own = state.own.carried(change, fresh.own)
            told = {f.name: getattr(own, f.name) for f in fields(ContactState)}
            law = told.pop("history")
            found |= {f"interface {i} {name}": value for name, value in told.items()}
            found |= {f"interface {i} law {name}": value for name, value in law.items()}
            for name in ("multiplier", "reported"):
                forces = self.kept[name][state.nodes.rows]
                found[name][fresh.nodes.rows] = _forces(before, now, at, forces)
            place, there = problem.operators.places[i], self.places[i]
            v = self.kept["w"][there.frame].reshape(before.directions.shape[:2])
            jumps = self.kept["w"][state.nodes.kappa]
            if change.frame is not None:
                moved = change.moved(np.einsum("md,mdg->mg", v, before.directions), jumps)
                v = np.einsum("mg,mdg->md", moved, now.directions)
            found["w"][place.frame] = v.ravel()
            found["w"][fresh.nodes.kappa] = change.turned(jumps) if jumps.size else jumps
        return found


def _told(geometry: InterfaceGeometry) -> tuple[Any, ...]:
    """What tells pairs and frames that are drawn at the same places from others."""
    site, counts = geometry.site, [len(pairs.nodes) for pairs in geometry.pairs]
    return site.carrier, site.prescribed, counts


def _forces(
    before: InterfaceGeometry, now: InterfaceGeometry, at: list[Any], forces: Array
) -> Array:
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
