"""Nodes that two rigid obstacles push the same way: one of them bears a node.

Both gaps change alike there, so that at most one can be closed where they differ, and what each
bears is left open where they do not. Rows of both would be the same row twice: a solver keeps one,
whatever the other asks for. The obstacle that is deeper in the body keeps its pair; of equals the
one that had it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from mpi4py import MPI

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import told
from dolfinx_llm.finite.load_step import Placed
from dolfinx_llm.finite.obstacles.obstacle_contact import ObstacleContact, ObstacleFriction
from dolfinx_llm.finite.pairs.terms import Place
from dolfinx_llm.laws.rows import OPEN

ONE_WAY = 1e-10  # of 1, by which the cosine between two ways may miss it


class Doubled:
    """Nodes that two interfaces with obstacles which are led have both.

    Args:
        comm: communicator.
        interfaces: all there are.
        reach: difference of gaps that is none [length].
    """

    def __init__(self, comm: MPI.Comm, interfaces: Sequence[Placed], reach: float) -> None:
        self._comm, self._reach = comm, reach
        kinds = ObstacleContact, ObstacleFriction
        led = [i for i, placed in enumerate(interfaces) if type(placed.what) in kinds]
        first = {i: interfaces[i].numbers[:: interfaces[i].what.sides.gdim] for i in led}
        self._shared = []
        for i, j in combinations(led, 2):
            _, at_i, at_j = np.intersect1d(first[i], first[j], return_indices=True)
            if len(at_i):
                self._shared.append((i, j, at_i, at_j))

    def once(
        self, now: Sequence[Array], before: Sequence[Array], places: Sequence[Place]
    ) -> list[Array]:
        """Status of the pairs, with those open that another obstacle bears; the same on all ranks,
        collective.

        Args:
            now, before: per interface (n,) status, and that of the last iterate.
            places: of them, in one configuration.
        """
        found = list(now)
        for i, j, at_i, at_j in self._shared:
            both = (found[i][at_i] != OPEN) & (found[j][at_j] != OPEN)
            n_i, n_j = places[i].normal[at_i], places[j].normal[at_j]
            both &= np.einsum("ni,ni->n", n_i, n_j) > 1.0 - ONE_WAY
            a, b = at_i[both], at_j[both]
            above = places[i].gap[a] - places[j].gap[b]
            came = (before[i][a] == OPEN) & (before[j][b] != OPEN)
            leaves = np.where(np.abs(above) > self._reach, above > 0.0, came)
            found[i], found[j] = found[i].copy(), found[j].copy()
            found[i][a[leaves]] = OPEN
            found[j][b[~leaves]] = OPEN
        return told(self._comm, found)
