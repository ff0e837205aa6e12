"""What the results of one interface share, be the deformation small or finite."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.cells import cross_plane, shape_functions
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.location import ClosestPoints

BEARING = 0.01  # of the largest pressure: a node of the frame with more is where the law has it
AS_NEAR = 1e-9  # of a frame's extent: bodies that touch it share it alike


def per_area(force: Array, area: Array) -> Array:
    """(m, k) forces over areas (m,), 0 where there is none [force / area]."""
    return np.asarray(force / np.where(area > 0.0, area, np.inf)[:, None])


def moments(arm: Array, force: Array) -> Array:
    """(k, 3) of forces (k, gdim) at arms; in the plane (k, 1)."""
    if arm.shape[1] == 2:
        return cross_plane(arm, force)[:, None]
    return np.cross(arm, force)


def closest(x: Array, cells: Array, points: Array) -> tuple[Array, Array, Array]:
    """Of the closest point of a surface to each point: nodes (k, c) of its cell, their parts in it
    (k, c), and (k, gdim) what lies between both along the surface, beyond its rim [length].

    Args:
        x: (n, gdim) nodes of the surface [length].
        cells: (f, c) of these, of first order.
        points: (k, gdim) [length].
    """
    used, corners = np.unique(cells, return_inverse=True)
    surface = ClosestPoints(x[used], corners.reshape(cells.shape))
    at = surface.locate(points)
    nodes, N = used[surface.cells[at.cell]], shape_functions(cells.shape[1], at.xi)[0]
    (rim, n), off = surface.around(at.cell, at.xi), points - np.einsum("kn,kni->ki", N, x[nodes])
    square = np.einsum("ki,ki->k", n, n)
    across = np.einsum("ki,ki->k", off, n) / np.where(square > 0.0, square, 1.0)
    return nodes, N, rim[:, None] * (off - across[:, None] * n)


class InterfaceForces:
    """Forces at the nodes of a frame, or of the body against a rigid obstacle, and what follows of
    them; ``sides`` have ``x``, where their ``force`` acts, ``drawn``, ``u`` and ``facets`` between
    them."""

    if TYPE_CHECKING:  # fields of what is derived from it
        frame: Frame | None
        sides: tuple[Any, ...]
        frame_force: Array
        frame_area: Array
        frame_friction: Array
        frame_status: Array
        frame_density: Array
        presses: bool
        firm: bool

    @property
    def x(self) -> Array:
        """(m, gdim) where pressure and friction are given: the frame's nodes [length]."""
        return self.sides[0].x if self.frame is None else self.frame.x

    @property
    def deformed(self) -> Array:
        """(m, gdim) the same in the deformed state; as drawn where a scalar field is solved for
        [length].

        A node of the frame is where its motion ``frame.v`` takes it as far as it bears something,
        else between the bodies that face it: beside contact pairs see small entries of corrected
        rows alone of some, of which the law tells next to nothing.
        """
        frame, drawn = self.frame, self.x
        if frame is None or frame.v is None or frame.v.shape != drawn.shape:
            return self.moved(1.0)
        at = self.frame_drawn + frame.v
        if self.firm or not frame.v.any():
            return at
        pressure = np.abs(self.pressure)
        bears = np.minimum(1.0, pressure / (BEARING * pressure.max(initial=0.0) or 1.0))
        between, apart = self._faced(1.0)
        off = np.linalg.norm(at - between, axis=1)
        most = (bears * apart).max()  # what bears lies between the bodies
        keeps = bears * np.where(off > most, most / np.where(off > 0.0, off, 1.0), 1.0)
        return np.where(keeps[:, None] < 1.0, between + keeps[:, None] * (at - between), at)

    def moved(self, scale: float) -> Array:
        """(m, gdim) ``x`` as drawn, between the bodies that face it, which are moved [length].

        Args:
            scale: factor on their displacements.
        """
        side = self.sides[0]
        if side.u.shape != side.drawn.shape:  # of a scalar field
            return self.x
        return side.drawn + scale * side.u if self.frame is None else self._faced(scale)[0]

    def _faced(self, scale: float) -> tuple[Array, Array]:
        """Between what faces the frame's nodes, moved by a factor on displacements, and nearer to
        that which is drawn nearer (m, gdim); how far both are apart (m,) [length]."""
        x, places, far = self.frame_drawn, [], []
        for side in self.sides:
            nodes, N, beside = closest(side.drawn, side.facets, x)
            met, u = (np.einsum("kn,kni->ki", N, values[nodes]) for values in (side.drawn, side.u))
            places.append(met + beside + scale * u)
            far.append(np.linalg.norm(met - x, axis=1) + AS_NEAR * np.ptp(x, axis=0).max())
        jump = places[1] - places[0]
        part = far[0] / (far[0] + far[1])
        return places[0] + part[:, None] * jump, np.linalg.norm(jump, axis=1)

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
        nodes, N, _ = closest(drawn, cells, points)
        return np.einsum("kn,kn->k", N, self.pressure[nodes])

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
