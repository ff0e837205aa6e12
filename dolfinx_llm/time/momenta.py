"""Momenta and energy of nonlinear bodies on which nothing acts but loads and each other.

Mean forces on the way of a step act about the places of its middle, contact forces and the rows of
a moving frame about those of its ends: angular momentum changes by more than the moment of the
loads, and energy by more than these do work, both by the third order of the step. At its end
velocities get the smallest change in the norm of the mass with which neither does: projection onto
invariants, Hairer, Lubich and Wanner, Geometric Numerical Integration (2006), IV.4. Moments are
about the centre of mass, which moves as the step says: about a point at rest a damped step would
turn a body that falls.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx import fem
from scipy.sparse.csgraph import connected_components

from dolfinx_llm.base import compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.cells import rigid_modes
from dolfinx_llm.operators.bodies import body_labels
from dolfinx_llm.operators.petsc import times


@dataclass(frozen=True, eq=False)
class End:
    """The start or the end of a step; this rank's values (n_local,)."""

    u: Array  # displacement [length]
    v: Array  # velocity [length / time]
    F: Array  # forces of the bodies less their loads, without contact [force]
    pushed: Array  # forces of contact [force]


class Momenta:
    """Projection of velocities, for groups of bodies that touch each other.

    Args:
        spaces: of the displacements.
        interfaces: between the bodies, or with obstacles.
        M: mass.
    """

    def __init__(self, spaces: Sequence[Any], interfaces: Sequence[Any], M: Any) -> None:
        self._comm, self._M, self._gdim = spaces[0].mesh.comm, M, spaces[0].mesh.geometry.dim
        found = [body_labels(V) for V in spaces]
        first = np.cumsum([0, *(count for _, count in found)])
        labels = [label + k for (label, _), k in zip(found, first, strict=False)]
        counts = [V.dofmap.index_map.size_local for V in spaces]
        own = zip(spaces, labels, counts, strict=True)
        parts = [(V.tabulate_dof_coordinates()[:n], label[:n]) for V, label, n in own]
        self._x = np.concatenate([x[:, : self._gdim] for x, _ in parts])
        self._body = np.repeat(np.concatenate([label for _, label in parts]), self._gdim)
        self._count = int(first[-1])
        self._around = any(callable(i.thickness) for i in interfaces)  # an axis, which holds all
        self._sides = [
            (self._any(_bodies(i, spaces, labels)), i.obstacle is not None, i.law.gives)
            for i in interfaces
        ]

    def projected(self, start: End, end: End, mean: Array, impulse: Any, fixed: Array) -> Array:
        """(n_local,) velocities at the end of a step; collective.

        Args:
            start, end: as they were found.
            mean: (n_local,) forces F on the way.
            impulse: of the forces at the start and at the end, over these: parts of the step.
            fixed: (n_local,) prescribed dofs.
        """
        group, free, limited = self._groups((start.pushed != 0.0) | (end.pushed != 0.0), fixed)
        if not free.any():
            return end.v
        of, B, n = group[self._body], self._motions(end.u), self._gdim
        B0, MB = self._motions(start.u), np.stack([times(self._M, b) for b in B.T], axis=1)
        Mv0, Mv = (times(self._M, v) for v in (start.v, end.v))
        own = [MB * end.v[:, None], B0 * Mv0[:, None]]
        own += [-impulse[0] * B0 * start.F[:, None], -impulse[1] * B * end.F[:, None]]
        own += [np.stack([end.v * Mv, start.v * Mv0 - 2.0 * mean * (end.u - start.u)], axis=1)]
        own += [(MB[:, :, None] * B[:, None]).reshape(len(B), B.shape[1] ** 2)]
        own += [(B0[:, n:, None] * MB[:, None, :n]).reshape(len(B), (B.shape[1] - n) * n)]
        sums = np.zeros((len(free), sum(part.shape[1] for part in own)))
        np.add.at(sums, of, np.concatenate(own, axis=1))
        sums = self._comm.allreduce(sums)
        widths = np.cumsum([part.shape[1] for part in own])[:-1]
        P, P0, J0, J, twice, G, G0 = np.split(sums, widths, axis=1)
        change, shrunk = np.zeros_like(P), np.ones(len(free))
        for g in np.flatnonzero(free):
            inertia = G[g].reshape(2 * [P.shape[1]])
            # Moments of what moves or acts at the centre of mass, about the origin.
            before, after = G0[g].reshape(-1, n) / inertia[0, 0], inertia[n:, :n] / inertia[0, 0]
            start_of = P0[g] + J0[g]
            spin = start_of[n:] - before @ start_of[:n] + J[g, n:] - after @ J[g, :n]
            wanted = np.append(P[g, :n], after @ P[g, :n] + spin)
            old, new = np.linalg.solve(inertia, np.stack([P[g], wanted], axis=1)).T
            inner, left = twice[g, 0] - old @ P[g], twice[g, 1] - new @ wanted
            if limited[g] and 0.0 <= left < inner:
                shrunk[g] = np.sqrt(left / inner)
            change[g] = new - shrunk[g] * old
        return shrunk[of] * end.v + np.einsum("nr,nr->n", B, change[of])

    def _groups(self, pushed: Array, fixed: Array) -> tuple[Array, Array, Array]:
        """(bodies,) number of the group that each belongs to; (groups,) whether supports and
        obstacles leave it alone, and whether its contact cannot store energy.

        Args:
            pushed, fixed: (n_local,) where contact acts, and which dofs are prescribed.
        """
        touched = self._any(self._body[pushed])
        joined, held = np.eye(self._count, dtype=bool), self._any(self._body[fixed]) | self._around
        stores = np.zeros(self._count, dtype=bool)
        for bodies, rigid, gives in self._sides:
            both = bodies & touched
            joined |= both[:, None] & both
            held |= both & rigid
            stores |= both & gives
        count, group = connected_components(joined, directed=False)
        free, limited = np.ones(count, dtype=bool), np.ones(count, dtype=bool)
        free[group[held]], limited[group[stores]] = False, False
        return group, free, limited

    def _any(self, bodies: Array) -> Array:
        """(bodies,) whether any rank names them."""
        named = np.bincount(bodies, minlength=self._count)
        return np.asarray(self._comm.allreduce(named)) > 0

    def _motions(self, u: Array) -> Array:
        """(n_local, r) translations, and turns of bodies at u about the origin."""
        x = self._x + u.reshape(self._x.shape)
        modes = rigid_modes(x)
        return modes.reshape(x.size, modes.shape[2])


def _bodies(interface: Any, spaces: Sequence[Any], labels: Sequence[Array]) -> Array:
    """Numbers of the bodies that an interface's sides are on, as far as this rank has them."""
    found = [np.zeros(0, dtype=int)]
    for tags, tag in interface.tagged_sides():
        for V, label in zip(spaces, labels, strict=True):
            if compat.tags_belong_to(tags, V.mesh):
                facets = tags.indices[tags.values == tag]
                dim = V.mesh.topology.dim - 1
                found.append(label[fem.locate_dofs_topological(V, dim, facets)])
    return np.concatenate(found)
