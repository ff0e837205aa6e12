"""What a load step is solved of, and where it starts and ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from petsc4py import PETSc

from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.finite.system import NewtonSystem, mean_diagonal
from dolfinx_llm.operators.numbering import BodyDofs


class Bodies(Protocol):
    """Nonlinear bodies without their contact."""

    dofs: BodyDofs
    size: float  # of the largest cell [length]
    version: int  # counts the changes of what they are made of
    in_time: bool  # load steps are steps in time: bodies may fly, and pairs that press at the start
    # of one stay in contact in it

    def residual(self, u: np.ndarray) -> np.ndarray:
        """This rank's residual of all dofs at u (n_local,)."""

    def tangent(self, u: np.ndarray) -> PETSc.Mat:
        """Its derivative, without conditions."""

    def inside_out(self, u: np.ndarray) -> tuple[int, list[float]]:
        """How many cells are inside out at u, and where one is drawn; collective."""


@dataclass(frozen=True, eq=False)
class Placed:
    """Contact or a follower load, and where its coordinates stand."""

    what: Any  # MovingContact or Follower
    numbers: np.ndarray  # (width,) dofs in the vector of all bodies
    drawn: np.ndarray  # (width,) coordinates as drawn [length]
    free: np.ndarray  # (width,) not prescribed

    def at(self, dofs: BodyDofs, u: np.ndarray) -> np.ndarray:
        """(width,) coordinates at this rank's u; collective."""
        return self.drawn + dofs.values(self.numbers, u)


@dataclass(frozen=True, eq=False)
class NewtonState:
    """An equilibrium."""

    u: np.ndarray  # (n_local,) this rank's displacement [length]
    own: tuple[np.ndarray, ...]  # unknowns of each interface
    status: tuple[np.ndarray | None, ...]  # of the pairs of each interface; None: not known yet
    pressures: np.ndarray  # of the follower loads [force / area]
    poses: tuple[np.ndarray, ...]  # per interface what places a rigid obstacle; empty without one
    kept: tuple[Any, ...]  # per interface what its own law keeps; None without one
    pushed: np.ndarray  # (n_local,) forces of contact and follower loads on the bodies [force]


@dataclass(frozen=True, eq=False)
class LoadStep:
    """A load step from one state to what is prescribed now."""

    start: NewtonState
    values: np.ndarray  # (n_local,) prescribed displacements at its end [length]
    pressures: np.ndarray  # at its end [force / area]
    poses: tuple[np.ndarray, ...]  # of rigid obstacles at its end
    unbalanced: np.ndarray  # (n_local,) residual of the start under the loads of its end [force]


@dataclass(eq=False)
class Equations:
    """All that a load step is solved of."""

    bodies: Bodies  # without their contact
    interfaces: Sequence[Placed]  # in contact
    followers: Sequence[Placed]  # follower loads
    system: NewtonSystem  # of the unknowns
    size: float  # of the facets in contact [length]
    times: StageTimes  # to which seconds are added
    scale: float = 0.0  # stiffness of the bodies, known with the first tangent [force / length]
    measured: int = -1  # version of the bodies that this is of

    def measure(self, u: np.ndarray) -> None:
        """Find the bodies' stiffness at this rank's u, once for what they are now; collective."""
        if self.measured != self.bodies.version:
            K = self.bodies.tangent(u)
            self.scale, self.measured = mean_diagonal(K), self.bodies.version
            K.destroy()
