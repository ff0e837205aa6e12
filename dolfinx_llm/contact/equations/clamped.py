"""Pairs that supports hold along the normal on both sides of an interface, where these meet.

Rims of curved meshes lie between each other's chords, as drawn or where supports have moved along
the surface. No force closes such a gap: by one form forces would grow from iteration to iteration,
the other's equations have no solution. Or frame nodes there, which corrected rows push along the
surface, run away. So pairs that tell the frame all, hold it there, and the others are left out. On
flat surfaces all say the same, and share forces, but where supports press bodies into each other.
Where they press a body into an obstacle its pairs there are left out: supports bear all.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, diags, identity

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.base.sparse import symmetric_factors
from dolfinx_llm.contact.equations.state import InterfaceState
from dolfinx_llm.operators.prescribed import SAID, independent_rows, pieces
from dolfinx_llm.operators.system import FLUSH, ContactOperators

ROUNDED_PART = 1e-8  # of the largest gap, that is rounding
TIE = 1e-3  # that the side with more of the frame's nodes is ahead by
FITS = 30  # after which all counts that rows tell by more than ``SAID``, and hardly what by less


class HeldRows:
    """Normal rows whose motion supports prescribe, of interfaces that may open.

    Args:
        operators: of the interfaces.
        normal: (n,) normal rows of such interfaces.
        L: (n, m) motion of frames, obstacles and slips as rows see it.
        drifts: (m,) normal motion of frames.
    """

    def __init__(
        self, operators: ContactOperators, normal: Array, L: csr_matrix, drifts: Array
    ) -> None:
        self._none, self._positions = np.zeros(len(normal), dtype=bool), operators.bodies.farthest
        both = np.flatnonzero(operators.both & normal)
        self._both = ClampedRows(operators, both, L[both][:, drifts]) if len(both) else None
        # On obstacles that no force moves.
        self._alone = operators.soft & normal & (L.getnnz(axis=1) == 0)

    def hold(self, states: Sequence[InterfaceState], g: Array) -> Array:
        """(n,) rows that are left out in a load step: of both sides where others hold the frame,
        and of nodes in an obstacle.

        Args:
            states: of the interfaces.
            g: (n,) gaps, where supports have moved [length].
        """
        left_out = self._both.hold(states, g) if self._both else self._none
        inside = self._alone & (g > _rounding(g, self._positions))
        for s in states:
            normal = s.nodes.rows[:, -1]
            if self._alone[normal].any():
                s.overlap = float(np.where(inside, g, 0.0)[normal].max())
                s.touch(s.own.active & ~inside[normal])
        return left_out | inside


def _rounding(g: Array, positions: float) -> float:
    """Of gaps g [length]."""
    return max(ROUNDED_PART * float(np.abs(g).max(initial=0.0)), FLUSH * positions)


class ClampedRows:
    """Normal rows whose motion is prescribed on both sides, of interfaces that may open.

    Args:
        operators: of the interfaces.
        rows: (k,) their numbers.
        told: (k, m) what they tell of the frames' normal motion.
    """

    def __init__(self, operators: ContactOperators, rows: Array, told: csr_matrix) -> None:
        self._comm, self._rows = operators.comm, rows
        curved = [g.curved for g in operators.geometries for _ in g.pairs]
        each = [pairs.base.shape[0] * pairs.base.shape[1] for pairs in operators.pairs]
        self._side = np.repeat(np.arange(len(each)), each)[rows]
        self._curved = np.asarray(curved)[self._side]
        self._told = told[:, np.unique(told.indices)]
        self._positions = operators.bodies.farthest

    def hold(self, states: Sequence[InterfaceState], g: Array) -> Array:
        """Hold frames where bodies meet so, in a load step; (n,) rows that are left out.

        Args:
            states: of the interfaces.
            g: (n,) gaps, where supports have moved [length].
        """
        left_out, holding, overlap = (np.zeros(len(g), dtype=of) for of in (bool, bool, float))
        missed = chosen(self._comm, lambda: self._missed(g[self._rows]))
        rounding = _rounding(g, self._positions)
        meets = missed > np.where(self._curved, -rounding, rounding)
        for holds, others in self._pieces if meets.any() else []:
            own = np.concatenate([holds, others])
            if meets[own].any():
                holding[self._rows[holds]] = left_out[self._rows[others]] = True
                overlap[self._rows[own]] = missed[own]
        for s in states:
            normal = s.nodes.rows[:, -1]
            s.clamped, s.overlap = holding[normal], float(overlap[normal].max(initial=0.0))
            s.touch(s.own.active & ~left_out[normal])
        return left_out

    @cached_property
    def _pieces(self) -> list[tuple[Array, Array]]:
        """Per piece of both sides that hangs together the rows from which the others follow, or
        nearly, and these. Rows of the frame's own nodes come first: others would hold it by larger
        forces. Of nodes that coincide that of the side with more of them does, whichever is named
        first."""

        def split() -> list[tuple[Array, Array]]:
            found, size = [], abs(self._told)
            total = size.sum(axis=1).A1
            pure = size.max(axis=1).toarray().ravel() / total
            means = np.bincount(self._side, pure) / np.maximum(np.bincount(self._side), 1)
            told = (diags(pure * (1.0 + TIE * means[self._side]) / total) @ self._told).tocsr()
            for piece in pieces(self._told):
                if np.ptp(self._side[piece]):
                    new = piece[independent_rows(told[piece], SAID)]
                    found.append((new, np.setdiff1d(piece, new)))
            return found

        return chosen(self._comm, split)

    def _missed(self, gaps: Array) -> Array:
        """(k,) by how much bodies overlap, where it is positive, at the frame that meets the gaps
        (k,) best, but for what the rows hardly tell."""
        for _ in range(FITS):
            gaps = gaps - self._told @ self._fit.solve(self._told.T @ gaps)
        return gaps

    @cached_property
    def _fit(self) -> Any:
        square = self._told.T @ self._told
        return symmetric_factors(square + SAID**2 * identity(square.shape[0]))
