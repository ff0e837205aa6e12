"""Where the unknowns of all interfaces stand in PETSc's vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from mpi4py import MPI
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    from dolfinx_llm.geometry.pairs import ContactPairs


@dataclass(frozen=True, eq=False)
class Numbering:
    """Global PETSc numbers of unknowns known to every rank: by owner, then in their own order."""

    owner: np.ndarray  # (n,) rank that owns each unknown
    rank: int

    @cached_property
    def number(self) -> np.ndarray:
        """(n,) global number of each unknown."""
        number = np.empty(len(self.owner), dtype=np.int64)
        number[np.argsort(self.owner, kind="stable")] = np.arange(len(self.owner))
        return number

    @cached_property
    def mine(self) -> np.ndarray:
        """This rank's unknowns, in the order of their numbers."""
        return np.flatnonzero(self.owner == self.rank)

    @property
    def sizes(self) -> tuple[int, int]:
        """Local and global number of unknowns."""
        return len(self.mine), len(self.owner)


@dataclass(frozen=True, eq=False)
class Rows:
    """The multipliers of several sides, one after the other: pair by pair, base by base vector."""

    base: np.ndarray  # (n, gdim) base vector of each
    dofs: np.ndarray  # (n, gdim) numbers of its node's dofs in the vector of all bodies
    numbering: Numbering

    @classmethod
    def of(cls, comm: MPI.Comm, pairs: Sequence[ContactPairs], dofs: Sequence[np.ndarray]) -> Rows:
        """Rows of sides whose nodes' dofs are given, per side (n, gdim)."""
        counts = [p.base.shape[1] for p in pairs]
        owner = [np.repeat(p.owner, c) for p, c in zip(pairs, counts)]
        gdim = pairs[0].base.shape[2]
        return cls(
            np.concatenate([p.base.reshape(-1, gdim) for p in pairs]),
            np.concatenate([np.repeat(d, c, axis=0) for d, c in zip(dofs, counts)]),
            Numbering(np.concatenate(owner), comm.rank),
        )


def frame_numbering(models: Sequence[Any], comm: MPI.Comm) -> Numbering:
    """Numbers of the frame unknowns, d per node; they live with the nearest surface node."""
    owners = [np.empty(0, dtype=np.int64)]
    for model in models:
        if model.frame is not None:
            x = np.concatenate([side.x for side in model.pairs])
            owner = np.concatenate([side.owner for side in model.pairs])
            nearest = owner[cKDTree(x).query(model.frame.x)[1]]
            owners.append(np.repeat(nearest, model.directions.shape[1]))
    return Numbering(np.concatenate(owners), comm.rank)


def slip_numbering(models: Sequence[Any], frames: Numbering) -> Numbering:
    """Numbers of frame unknowns followed by slip unknowns κ, which live with their frame node (with
    their surface node against a rigid obstacle)."""
    owners, first = [frames.owner], 0
    for model in models:
        m, d, gdim = model.directions.shape
        at = frames.owner[first : first + m * d : max(d, 1)]
        first += m * d
        if model.interface.law.friction:
            at = model.pairs[0].owner if model.frame is None else at
            owners.append(np.repeat(at, gdim - 1))
    return Numbering(np.concatenate(owners), frames.rank)
