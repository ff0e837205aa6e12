"""Rigid motions that supports leave to a body: free ones, and those that weak springs hold.

A body on springs that are weak against its own stiffness moves far: K⁻¹ is then that motion and
little else, and the forces in the body are differences of large numbers. So these motions are
told apart from the start, with a stiffness of their own, which is zero where nothing holds them.
Each moves one body alone, and K couples no bodies: all tables are sparse, and grow with the bodies.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg
from scipy.sparse import bsr_matrix, csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.base.sparse import NO_ROWS, placed
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.petsc import diagonal_of, products

STILL = 1e-10  # part of its size by which a rigid motion may move prescribed dofs and count as none
WEAK = 1e-2  # of a body's own stiffness, below which that of springs counts as weak
NOISE = 30.0  # rounding errors of K below which a rigid motion counts as free
FAR = 30.0  # sizes of cells from the origin, from which on their coordinates cost digits
EPS = np.finfo(float).eps


@dataclass(frozen=True, eq=False)
class RigidMotions:
    """k rigid motions of single bodies, each of about size 1; the free ones come first."""

    bodies: Bodies
    body: Array  # (k,) that each moves
    parts: Array  # (k, 3 or 6) of its body's motions in ``Bodies.own_modes``
    free: int  # how many of them nothing holds
    modes: csr_matrix  # (n_local, k) on this rank's dofs, zero at prescribed ones
    forces: csr_matrix  # (n_local, k) K times modes, zero for the free ones
    stiffness: csr_matrix  # (k, k) modesᵀ K modes
    noise: Array  # (k,) what rounding of K may have done to it

    def one_of_each(self, which: Array) -> list[Array]:
        """Motions ``which`` in groups with no more than one of each body, which one solve may take
        together: K does not couple bodies."""
        order = which[np.argsort(self.body[which], kind="stable")]
        new = np.diff(self.body[order], prepend=-1) != 0
        place = np.arange(len(order)) - np.maximum.accumulate(
            np.where(new, np.arange(len(order)), 0)
        )
        return [order[place == p] for p in range(place.max(initial=-1) + 1)]

    @cached_property
    def label(self) -> Array:
        """(n_local,) body of each of this rank's dofs; -1: of none."""
        label = np.full(self.modes.shape[0], -1)
        label[self.bodies.dofs] = np.repeat(self.bodies.label, self.bodies.components)
        return label

    def owner(self, some: Array) -> Array:
        """(n_local,) which of some motions, one of each body, is that of a dof's body; -1: none."""
        of = np.full(self.bodies.count + 1, -1)
        of[self.body[some]] = some
        return of[self.label]

    def pins(self, count: int) -> list[int]:
        """This rank's dofs (local numbers) that together hold the first motions best, ``count`` in
        all: of each body as many as it has motions, one after the other."""
        comm, groups = self.bodies.comm, self.one_of_each(np.arange(count))
        rest = np.zeros((self.modes.shape[0], len(groups)))
        for k, some in enumerate(groups):
            rest[:, k] = self.modes[:, some].sum(axis=1).A1
        chosen: list[int] = []
        for some in groups:
            size, bodies = np.einsum("nk,nk->n", rest, rest), self.body[some]
            best = np.full((len(some), 1 + len(groups)), -1.0)
            order = np.lexsort((-size, self.label))
            first = np.searchsorted(self.label[order], bodies)
            first = order[np.minimum(first, len(order) - 1)] if len(order) else 0 * bodies
            here = self.label[first] == bodies if len(order) else np.zeros(len(some), dtype=bool)
            best[here] = np.column_stack([size[first[here]], rest[first[here]]])
            every = np.array(comm.allgather(best))
            rank = every[:, :, 0].round(12).argmax(axis=0)
            chosen += first[rank == comm.rank].tolist()
            d = np.zeros((self.bodies.count + 1, len(groups)))
            d[bodies] = every[rank, np.arange(len(some)), 1:]
            d /= np.maximum(np.linalg.norm(d, axis=1), 1e-300)[:, None]
            along = d[self.label]
            rest -= np.einsum("nk,nk->n", rest, along)[:, None] * along
        return chosen

    def describe(self, amounts: Array, forces: Array, pushed: float = 0.0) -> str:
        """Words for (free,) amounts of the free motions, the forces (free,) along them and the work
        ``pushed`` that forces on obstacles do besides, which a body that moves alone is told of."""
        size, body = np.abs(amounts).max(initial=0.0), self.body[: self.free]
        moving = [own for own in (np.flatnonzero(body == b) for b in np.unique(body))
                  if np.abs(amounts[own]).max() >= 1e-3 * size]  # fmt: skip
        works = [float(amounts[own] @ forces[own]) for own in moving]
        total = sum(works) + pushed
        works = [total] if len(works) == 1 else works
        words = [
            self.bodies.motion(body[own[0]], amounts[own] @ self.parts[own], work)
            for own, work in zip(moving, works, strict=True)
        ]
        if abs(pushed) > 1e-3 * abs(total):
            words.append(f"forces on obstacles do {pushed / total:.0%} of the work")
        return "; ".join(words)


def no_motions(bodies: Bodies, n: int) -> RigidMotions:
    """None at all, of bodies with n dofs on this rank: where ties hold them nobody asks."""
    none, parts = csr_matrix((n, 0)), np.zeros((0, bodies.ways))
    body = np.zeros(0, dtype=np.int64)
    return RigidMotions(bodies, body, parts, 0, none, none, NO_ROWS, np.zeros(0))


def rigid_motions(bodies: Bodies, K: Any, fixed: Array) -> RigidMotions:
    """The rigid motions of each body that supports alone, (n_local,) fixed dofs, do not hold, or
    only by weak springs; K has identity rows at fixed dofs."""
    of = np.repeat(bodies.label, bodies.components)
    allowed = _allowed(bodies, fixed)
    moved = np.zeros((len(fixed), allowed.shape[2]))  # of all bodies at once
    own_modes = bodies.own_modes(bodies.label, bodies.points).reshape(-1, bodies.ways)
    moved[bodies.dofs] = _combined(own_modes, allowed, of)
    del own_modes  # the largest of all tables
    moved[fixed] = 0.0
    pushed, diagonal = products(K, moved), np.abs(diagonal_of(K))[bodies.dofs]
    found = _of_bodies(bodies, of, allowed, (moved[bodies.dofs], pushed[bodies.dofs], diagonal))
    order = [(b, j) for held in (False, True) for b, (_, _, h, _) in enumerate(found)
             for j in np.flatnonzero(h == held)]  # fmt: skip
    k, width = len(order), moved.shape[1]
    number, C = np.full((bodies.count, width), -1), np.zeros((bodies.count, width, width))
    parts, noise, free = np.zeros((k, bodies.ways)), np.zeros(k), 0
    for i, (b, j) in enumerate(order):
        vectors, _, held, level = found[b]
        number[b, j], C[b, : len(vectors), j] = i, vectors[:, j]
        parts[i], noise[i] = allowed[b][:, : len(vectors)] @ vectors[:, j], level[j]
        free += not held[j]
    shape, columns = (len(fixed), k), number[of]
    modes, forces = (
        placed(
            _combined(field[bodies.dofs], C, of) * (columns >= first),
            bodies.dofs[:, None],
            columns,
            shape,
        )  # fmt: skip
        for field, first in ((moved, 0), (pushed, free))
    )
    stiffness = bodies.comm.allreduce((modes.T @ forces).tocsr())
    body = np.array([b for b, _ in order], dtype=np.int64)
    stiffness = 0.5 * (stiffness + stiffness.T)
    return RigidMotions(bodies, body, parts, free, modes, forces, stiffness, noise)


def _combined(fields: Array, parts: Array, of: Array) -> Array:
    """(n, j) of fields (n, k) by parts (b, k, j), of those ``of`` each (n,); one by one, as tables
    (n, k, j) are the largest of all."""
    found = np.zeros((len(fields), parts.shape[2]))
    for k in range(parts.shape[1]):
        found += fields[:, k, None] * parts[:, k][of]
    return found


def left_by_supports(bodies: Bodies, fixed: Array) -> tuple[Array, Array]:
    """Rigid motions of single bodies that move no prescribed dof, springs or not: the body of each
    (k,), and (k, 3 or 6) its parts of that body's motions; (n_local,) fixed dofs."""
    allowed = _allowed(bodies, fixed)
    b, j = np.nonzero((allowed != 0.0).any(axis=1))
    return b, allowed[b, :, j]


def _allowed(bodies: Bodies, fixed: Array) -> Array:
    """(bodies, modes, k) combinations of each body's rigid motions that move no prescribed dof,
    then zeros; (n_local,) fixed dofs."""
    node, component = np.nonzero(fixed[bodies.dofs].reshape(-1, bodies.components))
    of, held = bodies.label[node], {}
    R = bodies.own_modes(of, bodies.points[node])[np.arange(len(node)), component]
    order = np.argsort(of, kind="stable")
    for own in np.split(order, np.flatnonzero(np.diff(of[order])) + 1) if len(of) else []:
        held[of[own[0]]] = np.linalg.qr(R[own], mode="r")
    every = bodies.comm.allgather(held)

    def left() -> Array:
        out = np.tile(np.eye(bodies.ways), (bodies.count, 1, 1))
        counts = np.full(bodies.count, bodies.ways)
        for b in sorted(set().union(*every)):
            _, values, vectors = np.linalg.svd(np.concatenate([h[b] for h in every if b in h]))
            rank = int((values > STILL * max(values.max(initial=0.0), 1.0)).sum())
            counts[b], out[b] = bodies.ways - rank, 0.0
            out[b, :, : counts[b]] = vectors[rank:].T
        return out[:, :, : counts.max(initial=0)]

    return chosen(bodies.comm, left)


def _of_bodies(bodies: Bodies, of: Array, allowed: Array, fields: Any) -> list[Any]:
    """Per body its motions, of ``fields`` at its dofs, that are free or weakly held: their
    coefficients (columns of ``allowed``, k), stiffness (k,), whether springs hold them (k,), and
    the stiffness that rounding alone may cause (k,)."""
    moved, pushed, diagonal = fields
    weighted, k = diagonal[:, None] * moved, moved.shape[1]
    products = np.zeros((bodies.count, k, 2 * k))  # of each body, with both
    if moved.size:
        left, right = (
            bsr_matrix((x[:, None, :], of, np.arange(len(of) + 1)), (len(of), bodies.count * width))
            for x, width in ((moved, k), (np.hstack([pushed, weighted]), 2 * k))
        )
        blocks = (left.T @ right).tobsr((k, 2 * k))
        products[blocks.indices] = blocks.data
    squares = np.bincount(of, (weighted**2).sum(axis=1), bodies.count)
    nodes = np.bincount(of, minlength=bodies.count) / bodies.components
    products, squares, nodes = map(bodies.comm.allreduce, (products, squares, nodes))
    own, size = products[:, :, :k], products[:, :, k:]
    across = nodes ** (1.0 / bodies.gdim)  # nodes from end to end
    # Places far from the origin lose digits, and with them the rigid motions of cells.
    extent = np.linalg.norm(bodies.high - bodies.low, axis=1)
    reach = np.maximum(np.abs(bodies.low), np.abs(bodies.high)).max(axis=1)
    far = np.maximum(reach / extent * across / FAR, 1.0)
    noise = NOISE * EPS * far * np.sqrt(squares)

    def weakly_held() -> list[Any]:
        found = []
        for b, count in enumerate((allowed != 0.0).any(axis=1).sum(axis=1)):
            if not count:
                found.append((np.zeros((0, 0)), np.zeros(0), np.zeros(0, dtype=bool), np.zeros(0)))
                continue
            mine = own[b, :count, :count]
            values, vectors = scipy.linalg.eigh(0.5 * (mine + mine.T), size[b, :count, :count])
            vectors = vectors[:, values * across[b] ** 2 < WEAK]
            vectors = vectors / np.linalg.norm(allowed[b, :, :count] @ vectors, axis=0)
            values = np.einsum("ij,ik,kj->j", vectors, mine, vectors)
            level = np.full(len(values), noise[b] / NOISE)
            found.append((vectors, values, values > noise[b], level))
        return found

    return chosen(bodies.comm, weakly_held)
