"""Bodies that have come apart: their frame goes between them.

Where nothing presses, what weakly holds a frame makes pairs touch and part by turns, without end on
coarse meshes whose rows extrapolate. A frame that is as far from both bodies as it can be touches
neither. It is the solution of a linear programme.
"""

from __future__ import annotations

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix, hstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.contact.equations.equations import Equations
from dolfinx_llm.contact.equations.state import InterfaceState

UNPARTED = 5  # iterations, after which pairs should have parted by themselves
FORCELESS = 1e-6  # forces over stiffness times motion, that press no bodies
OVERLAP = 0.1  # of the motion, by which bodies that have parted are in each other at most
WITHIN_EACH = 0.5  # the same, from which on a step in which nothing presses is none
AWAY = 2.0  # of the motion, that a frame goes between bodies: rows hardly see some of its nodes
WELL_CLEAR = 1e-4  # of the motion: how far bodies are apart that will not meet without these forces


class Parted:
    """Interfaces whose frames have gone between their bodies in a load step, once each.

    Args:
        equations: of the laws.
        comm: ranks.
    """

    def __init__(self, equations: Equations, comm: MPI.Comm) -> None:
        self._equations, self._comm = equations, comm
        self._rest = [s for s in equations.states if s.law.opens and not s.nodes.geometry.rigid]
        self._every, self._sought = tuple(self._rest), list(self._rest)

    def frame(self, w: Array, multiplier: Array, position: Array, iteration: int) -> Array:
        """(m,) where frames are to go on from; pairs of those between bodies that have parted are
        open.

        Args:
            w: (m,) the same, of all others [length].
            multiplier: λ (n,) [force].
            position: (n,) of the bodies at all rows [length].
            iteration: its number in the load step.
        """
        found = w
        for s in list(self._rest) if iteration > UNPARTED else ():
            motion = self._forceless(s, multiplier, position)
            if motion and (between := self._between(s, position, motion)):
                found, (at, place) = found.copy(), between
                found[at] = place
                s.touch(np.zeros(len(s.nodes.rows), dtype=bool))
                self._rest.remove(s)
        return found

    def lost(self, multiplier: Array, position: Array) -> bool:
        """Whether nothing presses between bodies that are in each other, once for each: slips of an
        iterate have taken their frame away.

        Args:
            multiplier, position: as of ``frame``.
        """
        for s in self._sought:
            motion = self._forceless(s, multiplier, position)
            if motion and _distance(s, position) < -OVERLAP * motion:
                self._sought.remove(s)
                return True
        return False

    def require_contact(self, multiplier: Array, position: Array) -> None:
        """Require forces where bodies are in each other by more than half of their way.

        Args:
            multiplier, position: as of ``frame``, at the end.

        Raises:
            ContactError: there are none.
        """
        for s in self._every:
            motion = self._forceless(s, multiplier, position)
            if motion and (distance := _distance(s, position)) < -WITHIN_EACH * motion:
                raise ContactError(
                    f"interface {s.nodes.geometry.interface.name}: nothing presses, and the bodies "
                    f"are in each other by {-distance:.3g}: on surfaces so coarse the frame may be "
                    "clear of both. Use finer meshes along it, or smaller steps"
                )

    def _forceless(self, s: InterfaceState, multiplier: Array, position: Array) -> float:
        """The largest motion of the pairs where no force to speak of acts between them, else 0."""
        rows = s.nodes.rows
        forces, motion = (np.abs(a[rows]).max(initial=0.0) for a in (multiplier, position))
        return float(motion) if forces <= FORCELESS * self._equations.scale * motion else 0.0

    def _between(
        self, s: InterfaceState, position: Array, motion: float
    ) -> tuple[Array, Array] | None:
        """Unknowns of a frame (k,) and where they touch no body (k,); None: they cannot."""
        rows = s.nodes.rows[:, -1]
        if _distance(s, position) < -OVERLAP * motion:
            return None  # of corrected rows, which extrapolate, a frame may be clear of both
        L = self._equations.L[rows][:, s.nodes.v]
        at = np.unique(L.indices)
        found = chosen(self._comm, lambda: _farthest(L[:, at], position[rows], motion))
        return None if found is None else (s.nodes.v[at], found)


def _distance(s: InterfaceState, position: Array) -> float:
    """The least one between the bodies, of the rows' positions (n,), along the pairs' own normals,
    as they are without a frame, at nodes over the other side [length]: beside it the frame is not
    between them."""
    geometry = s.nodes.geometry
    pairs = geometry.pairs
    parts = np.split(position[s.nodes.rows[:, -1]], [len(pairs[0].nodes)])
    nodal = [a if p.control is None else p.control @ a for p, a in zip(pairs, parts, strict=True)]
    each = enumerate(zip(geometry.opposite, geometry.faced, strict=True))
    gaps = [-(nodal[k] + N @ nodal[1 - k])[faced] for k, (N, faced) in each]
    return min(float(gap.min(initial=np.inf)) for gap in gaps)


def _farthest(L: csr_matrix, position: Array, motion: float) -> Array | None:
    """(k,) the frame with the largest least gap, L w - position, if that is clear."""
    from scipy.optimize import linprog  # rarely needed, and a third of the time of all imports

    n, k = L.shape
    gap = csr_matrix(-np.ones((n, 1)))
    best = linprog(  # in the motion's units: tolerances there are numbers
        np.append(np.zeros(k), -1.0),
        A_ub=-hstack([L, gap]).tocsr(),
        b_ub=-position / motion,
        bounds=[(-AWAY, AWAY)] * k + [(None, 1.0)],
        method="highs",
    )
    clear = best.status == 0 and best.x[-1] > WELL_CLEAR
    return motion * np.asarray(best.x[:-1]) if clear else None
