"""What the results of one interface share, be the deformation small or finite."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.cells import cross_plane
from dolfinx_llm.geometry.frame import Frame


def per_area(force: Array, area: Array) -> Array:
    """(m, k) forces over areas (m,), 0 where there is none [force / area]."""
    return np.asarray(force / np.where(area > 0.0, area, np.inf)[:, None])


def moments(arm: Array, force: Array) -> Array:
    """(k, 3) of forces (k, gdim) at arms; in the plane (k, 1)."""
    if arm.shape[1] == 2:
        return cross_plane(arm, force)[:, None]
    return np.cross(arm, force)


class InterfaceForces:
    """Forces at the nodes of a frame, or of the body against a rigid obstacle, and what follows of
    them; ``sides`` have ``x``, where their ``force`` acts, ``drawn`` and ``u``."""

    if TYPE_CHECKING:  # fields of what is derived from it
        frame: Frame | None
        sides: tuple[Any, ...]
        frame_force: Array
        frame_area: Array
        frame_friction: Array
        frame_status: Array
        frame_density: Array
        presses: bool

    @property
    def x(self) -> Array:
        """(m, gdim) where pressure and friction are given: the frame's nodes [length]."""
        return self.sides[0].x if self.frame is None else self.frame.x

    @property
    def deformed(self) -> Array:
        """(m, gdim) the same in the deformed state; as drawn where a scalar field is solved for
        [length]."""
        if self.frame is None:
            return self.sides[0].drawn + self.sides[0].u
        still = self.frame.v is None or self.frame.v.shape != self.frame_drawn.shape
        return self.frame_drawn if still else self.frame_drawn + self.frame.v

    @property
    def frame_drawn(self) -> Array:
        """(m, gdim) the frame's nodes as drawn [length]."""
        assert self.frame is not None
        return self.frame.x

    @property
    def pressure(self) -> Array:
        """(m,) contact pressure at the frame's nodes [force / area].

        Nodal force over tributary area misleads on the finer side; on the frame both sides carry
        the same force. Where bodies may part it is at least 0: at the rim of contact a corrected
        row may leave a frame node a slightly negative share of forces that all press, which
        ``frame_force`` shows and the pressure does not. Where corrected rows leave a node less than
        half of the area about it, or less than none, it is the mean pressure of the pairs there;
        where less than a fifth of its cells is covered and it has more than twice the pressure of
        its neighbours, as beside an edge, it is the mean of theirs. Between second-order bodies,
        whose nodal forces per area say nothing, it is that of ``SideResult.density`` of the side
        with fewer nodes. Where any of these is, its sum times ``frame_area`` is not the force:
        take ``resultant``, or the sum of ``frame_force``.
        """
        pressure = self.frame_density[:, 0]
        return np.maximum(pressure, 0.0) if self.presses else pressure

    @property
    def flux(self) -> Array:
        """(m,) of a scalar field: what flows from side 0 to side 1 at the frame's nodes
        [power / area]; ``resultant`` is all of it."""
        return self.pressure

    def pressure_at(self, x: ArrayLike) -> Array:
        """(k,) contact pressure at the points of the frame, as drawn, that are closest to
        positions: linear between its nodes [force / area].

        Args:
            x: (k, gdim) positions [length].

        Raises:
            ContactInputError: x has another shape.
        """
        if self.frame is None:
            drawn, cells = self.sides[0].drawn, self.sides[0].facets
        else:
            drawn, cells = self.frame_drawn, self.frame.corners
        accepted = f"give (k, {drawn.shape[1]}) positions"
        points = checks.array("x", x, (None, drawn.shape[1]), accepted)
        used, corners = np.unique(cells, return_inverse=True)
        corners = corners.reshape(cells.shape)
        at = Frame(drawn[used], corners).locate(points)
        N = np.maximum(at.N, 0.0)  # beyond the rim the nearest point of it counts
        N /= N.sum(axis=1, keepdims=True)
        return np.einsum("kn,kn->k", N, self.pressure[used][corners[at.cell]])

    @property
    def traction(self) -> Array:
        """(m, gdim) tangential traction of side 0 on the frame at its nodes, where pressure is that
        of pairs theirs, as much as the node's own friction allows [force / area]."""
        return self.frame_density[:, 1:]

    @property
    def resultant(self) -> Array:
        """(gdim,) total force of side 0 on side 1 (of the body on an obstacle) [force].

        At small deformation, where supports end at the interface, what goes through it there is
        what the body exerts, f - K u of its nodes, as far as the other side takes it up.
        """
        return self.sides[0].force.sum(axis=0)

    def moment(self, about: ArrayLike | None = None, side: int = 0) -> Array:
        """Moment of a side's forces: (3,), or (1,) in 2D [force length].

        Args:
            about: (gdim,) point; the origin by default [length].
            side: whose forces on the frame: 0 or 1; 0 against an obstacle.

        Raises:
            ContactInputError: no such side, or no point; a scalar field, which has no moment.
        """
        accepted = "give the number of a side, 0 or 1; 0 against an obstacle"
        if checks.integer("side", side, accepted, low=0) >= len(self.sides):
            checks.refuse("side", side, accepted)
        of = self.sides[side]
        gdim = of.x.shape[1]
        if of.force.shape[1] != gdim:
            raise ContactInputError("moment: what flows in a scalar field has none; see resultant")
        point = np.zeros(gdim) if about is None else about
        arm = of.x - checks.array("about", point, (gdim,), f"give a point, {gdim} numbers")
        return moments(arm, of.force).sum(axis=0)
