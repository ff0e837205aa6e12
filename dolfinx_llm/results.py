"""What a solve gives per interface, the same on every rank."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dolfinx_llm.frame import Frame
from dolfinx_llm.interface import Certificate

OPEN, STICK, SLIP = 0, 1, 2


@dataclass(frozen=True)
class SideResult:
    """One side of an interface; n nodes in contact, sorted by position."""

    x: np.ndarray  # (n, gdim) node positions X [length]
    u: np.ndarray  # (n, gdim) their displacements [length]
    force: np.ndarray  # (n, gdim) forces that the body exerts on the frame [force]
    normal: np.ndarray  # (n, gdim) frame normal, out of this side
    normal_force: np.ndarray  # (n,) positive in compression [force]
    gap: np.ndarray  # (n,) distance to the frame along the normal, positive when open [length]
    slip: np.ndarray  # (n, gdim) tangential motion relative to the frame [length]
    status: np.ndarray  # (n,) 0 open, 1 stick, 2 slip
    area: np.ndarray  # (n,) tributary area: the force of unit pressure [area]

    @property
    def tangential_force(self) -> np.ndarray:
        """(n, gdim) part of the force in the contact plane [force]."""
        return self.force - self.normal_force[:, None] * self.normal


@dataclass(frozen=True)
class InterfaceResult:
    """Result of one interface."""

    frame: Frame  # with its displacement v, (m, gdim) [length]
    sides: tuple[SideResult, SideResult]
    certificate: Certificate
    frame_force: np.ndarray  # (m,) normal force of side 0 at the frame's nodes, L_bᵀ λ_n [force]
    frame_area: np.ndarray  # (m,) tributary area of the frame's nodes, L_bᵀ of the sides' [area]

    @property
    def pressure(self) -> np.ndarray:
        """(m,) contact pressure at the frame's nodes [force / area].

        Nodal force over tributary area misleads on the finer side; on the frame both sides carry
        the same force.
        """
        area = self.frame_area
        return np.where(area > 0.0, self.frame_force / np.where(area > 0.0, area, 1.0), 0.0)

    @cached_property
    def resultant(self) -> np.ndarray:
        """(gdim,) total force of side 0 on the frame [force]."""
        return self.sides[0].force.sum(axis=0)
