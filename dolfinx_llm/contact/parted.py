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
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.contact.equations import Equations
from dolfinx_llm.contact.state import InterfaceState

UNPARTED = 5  # iterations, after which pairs should have parted by themselves
FORCELESS = 1e-6  # forces over stiffness times motion, that press no bodies
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
            rows = s.nodes.rows
            forces, motion = (np.abs(a[rows]).max(initial=0.0) for a in (multiplier, position))
            if not motion > 0.0 or forces > FORCELESS * self._equations.scale * motion:
                continue
            if between := self._between(s, position, motion):
                found, (at, place) = found.copy(), between
                found[at] = place
                s.touch(np.zeros(len(rows), dtype=bool))
                self._rest.remove(s)
        return found

    def _between(
        self, s: InterfaceState, position: Array, motion: float
    ) -> tuple[Array, Array] | None:
        """Unknowns of a frame (k,) and where they touch no body (k,); None: they cannot."""
        rows = s.nodes.rows[:, -1]
        L = self._equations.whole[rows][:, s.nodes.v]
        at = np.unique(L.indices)
        found = chosen(self._comm, lambda: _farthest(L[:, at], position[rows], motion))
        return None if found is None else (s.nodes.v[at], found)


def _farthest(L: csr_matrix, position: Array, motion: float) -> Array | None:
    """(k,) the frame with the largest least gap, L w - position, if that is clear."""
    from scipy.optimize import linprog  # rarely needed, and a third of the time of all imports

    n, k = L.shape
    gap = csr_matrix(-np.ones((n, 1)))
    best = linprog(  # in the motion's units: tolerances there are numbers
        np.append(np.zeros(k), -1.0),
        A_ub=-hstack([L, gap]).tocsr(),
        b_ub=-position / motion,
        bounds=[(None, None)] * k + [(None, 1.0)],
        method="highs",
    )
    clear = best.status == 0 and best.x[-1] > WELL_CLEAR
    return motion * np.asarray(best.x[:-1]) if clear else None
