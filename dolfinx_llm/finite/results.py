"""What a nonlinear solve gives per interface, in the current configuration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix, diags

from dolfinx_llm.finite.terms import ContactTerms, MovingContact
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.laws.rows import CLOSED, OPEN, SLIP, STICK


@dataclass(frozen=True, eq=False)
class MovingSideResult:
    """One side of an interface; n nodes of its surface, sorted by position as drawn."""

    X: np.ndarray  # (n, gdim) as drawn [length]
    x: np.ndarray  # (n, gdim) now [length]
    force: np.ndarray  # (n, gdim) forces that the body exerts on the frame [force]
    normal: np.ndarray  # (n, gdim) frame normal, out of this side; 0 away from contact
    normal_force: np.ndarray  # (n,) positive in compression [force]
    gap: np.ndarray  # (n,) to the other body along the normal; inf where there is none [length]
    slip: np.ndarray  # (n, gdim) tangential motion on the other body in the last increment [length]
    status: np.ndarray  # (n,) 0 open, 1 stick, 2 slip, 3 closed without friction
    area: np.ndarray  # (n,) tributary area of what both surfaces cover [area]
    facets: np.ndarray  # (m, k) facets of the surface

    @property
    def u(self) -> np.ndarray:
        """(n, gdim) displacements [length]."""
        return self.x - self.X


@dataclass(frozen=True, eq=False)
class MovingInterfaceResult:
    """Result of one interface, in the current configuration.

    The frame's nodes are those of the coarser surface; ``frame.v`` is their displacement since the
    drawing. Forces there are those of side 0.
    """

    frame: Frame  # its nodes now; its normal points out of side 0
    sides: tuple[MovingSideResult, MovingSideResult]  # in the interface's order
    frame_force: np.ndarray  # (m,) normal force at the frame's nodes [force]
    frame_area: np.ndarray  # (m,) tributary area of what both surfaces cover [area]
    frame_friction: np.ndarray  # (m, gdim) tangential force of side 0 there [force]
    frame_status: np.ndarray  # (m,) 0 open, 1 stick, 2 slip, 3 closed without friction
    correction: float  # largest change of a row by the design

    @property
    def x(self) -> np.ndarray:
        """(m, gdim) where pressure and traction are given: the frame's nodes now [length]."""
        return self.frame.x

    @property
    def pressure(self) -> np.ndarray:
        """(m,) contact pressure at the frame's nodes, 0 where nothing covers [force / area]."""
        area = self.frame_area
        return np.where(area > 0.0, self.frame_force / np.where(area > 0.0, area, 1.0), 0.0)

    @property
    def traction(self) -> np.ndarray:
        """(m, gdim) tangential traction of side 0 at the frame's nodes [force / area]."""
        area = np.where(self.frame_area > 0.0, self.frame_area, np.inf)
        return self.frame_friction / area[:, None]

    @property
    def resultant(self) -> np.ndarray:
        """(gdim,) total force of side 0 on side 1 [force]."""
        return self.sides[0].force.sum(axis=0)

    def moment(self, about: ArrayLike | None = None, side: int = 0) -> np.ndarray:
        """Moment of a side's forces where they act now: (3,), or (1,) in 2D [force length].

        Args:
            about: (gdim,) point; the origin by default [length].
            side: whose forces on the frame.
        """
        of = self.sides[side]
        arm = of.x - (0.0 if about is None else np.asarray(about, dtype=float))
        if arm.shape[1] == 2:
            return np.array([np.sum(arm[:, 0] * of.force[:, 1] - arm[:, 1] * of.force[:, 0])])
        return np.cross(arm, of.force).sum(axis=0)


def moving_results(
    contact: MovingContact, z: np.ndarray, terms: ContactTerms
) -> MovingInterfaceResult:
    """The result of one interface; the same on every rank.

    Args:
        contact: the interface.
        z: all its coordinates [length].
        terms: in this configuration.
    """
    sides, place, status = contact.sides, terms.place, terms.status
    active = status != OPEN
    forces = sides.in_order(*sides.split(-terms.force))
    places = sides.in_order(*sides.split(z))
    y = sides.split(z)[1]
    outward = sides.outward(z)
    normals = sides.in_order(-place.normal, outward)
    loaded = np.asarray(abs(place.N).T @ active.astype(float)).ravel() > 0.0
    at_frame = np.full(len(loaded), OPEN)
    for kind in (STICK, SLIP, CLOSED):
        at_frame[np.asarray(abs(place.N).T @ (status == kind)).ravel() > 0.0] = kind
    slips = sides.in_order(terms.slip, _at_frame(place.N, terms.slip, active))
    gaps = sides.in_order(np.where(active, 0.0, place.gap), np.where(loaded, 0.0, np.inf))
    statuses, areas = sides.in_order(status, at_frame), sides.in_order(*place.areas)
    first, second = (
        MovingSideResult(
            X=surface.x,
            x=places[k],
            force=forces[k],
            normal=normals[k],
            normal_force=np.einsum("ni,ni->n", forces[k], normals[k]),
            gap=gaps[k],
            status=statuses[k],
            slip=slips[k],
            area=areas[k],
            facets=surface.facets,
        )
        for k, surface in enumerate(sides.surfaces)
    )
    sign = 1.0 if sides.frame == 0 else -1.0
    total, normal = sign * forces[sides.frame], sign * outward
    force = np.einsum("mi,mi->m", total, normal)
    friction = total - force[:, None] * normal
    if terms.friction is not None:
        friction = -sign * sides.split(terms.friction)[1]
        force = np.einsum("mi,mi->m", total - friction, normal)
    cells = sides.facets(False)
    drawn = sides.surfaces[sides.frame].x
    return MovingInterfaceResult(
        frame=Frame(y, cells if sides.frame == 0 else cells[:, ::-1], v=y - drawn),
        sides=(first, second),
        frame_force=force,
        frame_area=place.areas[1],
        frame_friction=friction,
        frame_status=at_frame,
        correction=terms.delta,
    )


def _at_frame(N: csr_matrix, slip: np.ndarray, active: np.ndarray) -> np.ndarray:
    """(m, gdim) slip of the frame's nodes on the other body: minus the mean of what pairs there
    slip."""
    weights = abs(N).T @ diags(active.astype(float))
    total = np.asarray(weights.sum(axis=1)).ravel()
    return -(weights @ slip) / np.where(total > 0.0, total, 1.0)[:, None]
