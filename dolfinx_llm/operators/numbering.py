"""Where the dofs of all bodies and the unknowns of all interfaces stand in vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.at_nodes import values_at_surfaces
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.geometry.spaces import order_of
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.geometry import InterfaceGeometry


@dataclass(frozen=True, eq=False)
class BodyDofs:
    """Numbers of the bodies' dofs in PETSc's vectors: rank by rank, and there mesh by mesh."""

    comm: MPI.Comm
    spaces: tuple[Any, ...]  # function space of each mesh
    fixed: Array  # (n_local,) whether a Dirichlet condition prescribes a dof of this rank
    others: tuple[int, ...] = ()  # of each mesh dofs of this rank, after those of the nodes, that
    # are no displacements; none where no space is mixed

    @property
    def gdim(self) -> int:
        """Dimensions of space."""
        return self.spaces[0].mesh.geometry.dim

    @property
    def components(self) -> int:
        """Dofs per node: gdim, or 1 of a scalar field."""
        return self.spaces[0].dofmap.index_map_bs

    @cached_property
    def counts(self) -> list[int]:
        """This rank's dofs of each mesh."""
        others = self.others or (0,) * len(self.spaces)
        nodes = [V.dofmap.index_map.size_local for V in self.spaces]
        return [n * self.components + k for n, k in zip(nodes, others, strict=True)]

    def fixed_by_space(self) -> list[Array]:
        """Per mesh this rank's (n,) prescribed dofs."""
        return np.split(self.fixed, np.cumsum(self.counts)[:-1])

    @property
    def order(self) -> int:
        """Highest order of the spaces."""
        return max(order_of(V) for V in self.spaces)

    @property
    def mixed(self) -> bool:
        """Whether there are dofs that are no displacements."""
        return bool(self.others)

    @cached_property
    def of_nodes(self) -> Array:
        """(k,) this rank's dofs that are displacements, node by node (local numbers)."""
        ends = np.cumsum(self.counts) - (self.others or 0)
        starts = np.cumsum([0, *self.counts[:-1]])
        return np.concatenate([np.arange(*part) for part in zip(starts, ends, strict=True)])

    def spread(self, nodal: Array) -> Array:
        """(n_local,) at the dofs from values of this rank's nodes; 0 at all others."""
        values = np.zeros(len(self.fixed))
        values[self.of_nodes] = np.repeat(nodal, self.components)
        return values

    def sampled(self, function: Any, space: int, at: Array) -> Array:
        """(n,) values of a scalar Function at surface nodes of a space on its mesh; collective.

        Args:
            at: (n,) one dof of each node.
        """
        nodal = [np.zeros(V.dofmap.index_map.size_local) for V in self.spaces]
        nodal[space] = values_at_surfaces(function, self.spaces[space])
        return self.values(at, self.spread(np.concatenate(nodal)))

    @cached_property
    def sizes(self) -> tuple[int, int]:
        """Local and global number of dofs."""
        return len(self.fixed), self.comm.allreduce(len(self.fixed))

    @cached_property
    def first(self) -> int:
        """Number of this rank's first dof."""
        return sum(self.comm.allgather(len(self.fixed))[: self.comm.rank])

    @cached_property
    def points(self) -> Array:
        """(nodes, gdim) this rank's nodes as drawn [length]."""
        counts = [V.dofmap.index_map.size_local for V in self.spaces]
        x = [V.tabulate_dof_coordinates()[:n] for V, n in zip(self.spaces, counts, strict=True)]
        return np.concatenate(x)[:, : self.gdim]

    def of(self, space: int, nodes: ContactPairs | Surface) -> Array:
        """(n, components) numbers of the dofs of pairs or of a surface of a mesh."""
        k = self.components
        start = self.spaces[space].dofmap.index_map.local_range[0] * k
        shift = self.first + sum(self.counts[:space]) - start
        shift = np.array(self.comm.allgather(shift))[nodes.owner]
        return nodes.dofs[:, None] * k + np.arange(k) + shift[:, None]

    def values(self, dofs: Array, local: Array) -> Array:
        """Values at dofs (...) given by number, on every rank, from this rank's (n_local,)."""
        at = dofs - self.first
        mine = (at >= 0) & (at < len(local))
        values = np.zeros(at.shape)
        values[mine] = local[at[mine]]
        self.comm.Allreduce(MPI.IN_PLACE, values)
        return values


@dataclass(frozen=True)
class Place:
    """Where one interface stands in the vectors and lists of all interfaces."""

    sides: slice  # of the sides
    pairs: slice  # of the surface nodes of all sides
    rows: slice  # of the multipliers λ
    frame: slice  # of the frame unknowns v, the first of w
    slips: slice  # of w: slip unknowns κ, which follow all v


def places(geometries: Sequence[InterfaceGeometry]) -> list[Place]:
    """Places of the interfaces, one after the other in every vector."""
    frames = [g.directions.shape[0] * g.directions.shape[1] for g in geometries]
    ends, found = [0, 0, 0, 0, sum(frames)], []
    for geometry, frame in zip(geometries, frames, strict=True):
        n = sum(len(side.nodes) for side in geometry.pairs)
        _, c, gdim = geometry.pairs[0].base.shape
        slips = len(geometry.law_nodes[0]) * geometry.interface.law.jumps(gdim)
        starts, sizes = ends, (len(geometry.pairs), n, n * c, frame, slips)
        ends = [start + size for start, size in zip(starts, sizes, strict=True)]
        found.append(Place(*map(slice, starts, ends)))
    return found


@dataclass(frozen=True, eq=False)
class Numbering:
    """Global PETSc numbers of unknowns known to every rank: by owner, then in their own order."""

    owner: Array  # (n,) rank that owns each unknown
    rank: int

    @cached_property
    def number(self) -> Array:
        """(n,) global number of each unknown."""
        number = np.empty(len(self.owner), dtype=np.int64)
        number[np.argsort(self.owner, kind="stable")] = np.arange(len(self.owner))
        return number

    @cached_property
    def mine(self) -> Array:
        """This rank's unknowns, in the order of their numbers."""
        return np.flatnonzero(self.owner == self.rank)

    @property
    def sizes(self) -> tuple[int, int]:
        """Local and global number of unknowns."""
        return len(self.mine), len(self.owner)


@dataclass(frozen=True, eq=False)
class Rows:
    """The multipliers of several sides, one after the other: pair by pair, base by base vector."""

    base: Array  # (n, gdim) base vector of each
    dofs: Array  # (n, gdim) numbers of its node's dofs in the vector of all bodies
    numbering: Numbering

    @classmethod
    def of(cls, comm: MPI.Comm, pairs: Sequence[ContactPairs], dofs: Sequence[Array]) -> Rows:
        """Rows of sides whose nodes' dofs are given, per side (n, gdim)."""
        counts = [p.base.shape[1] for p in pairs]
        owner = [np.repeat(p.owner, c) for p, c in zip(pairs, counts)]
        gdim = pairs[0].base.shape[2]
        return cls(
            np.concatenate([p.base.reshape(-1, gdim) for p in pairs]),
            np.concatenate([np.repeat(d, c, axis=0) for d, c in zip(dofs, counts)]),
            Numbering(np.concatenate(owner), comm.rank),
        )


def frame_numbering(geometries: Sequence[InterfaceGeometry], comm: MPI.Comm) -> Numbering:
    """Numbers of the frame unknowns, d per node; they live with surface nodes next to them."""
    owners = [np.empty(0, dtype=np.int64)]
    for geometry in geometries:
        owners.append(np.repeat(_owners(geometry, geometry.places), geometry.directions.shape[1]))
    return Numbering(np.concatenate(owners), comm.rank)


def slip_numbering(geometries: Sequence[InterfaceGeometry], frames: Numbering) -> Numbering:
    """Numbers of frame unknowns followed by slip unknowns κ, which live with their law's node."""
    owners = [frames.owner]
    for geometry in geometries:
        jumps = geometry.interface.law.jumps(geometry.directions.shape[2])
        owners.append(np.repeat(_owners(geometry, geometry.law_nodes[0]), jumps))
    return Numbering(np.concatenate(owners), frames.rank)


def _owners(geometry: InterfaceGeometry, x: Array) -> Array:
    """(k,) ranks for what stands at positions (k, gdim): those that own the sides' nodes next to
    them. Where these are two, each takes half of the positions, in one piece, so that both have
    work with them."""
    every = np.concatenate([side.owner for side in geometry.pairs])
    if (every == every[0]).all():
        return np.full(len(x), every[0])
    near = [side.owner[cKDTree(side.x).query(x)[1]] for side in geometry.pairs]
    owner, other = near[0].copy(), near[-1]
    apart = np.flatnonzero(owner != other)
    pairs, number = np.unique(np.stack([owner, other])[:, apart], axis=1, return_inverse=True)
    for k, (_, second) in enumerate(pairs.T):
        at = apart[number.ravel() == k]
        along = np.argmax(np.ptp(x[at], axis=0))
        order = np.argsort(x[at, along], kind="stable")
        owner[at[order[len(at) // 2 :]]] = second
    return owner
