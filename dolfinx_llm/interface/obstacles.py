"""Rigid obstacles, as one side of an interface: no mesh, no unknowns but a prescribed force's.

An obstacle says for points of a body how far its surface is and in which direction. Between solves
it can be moved, turned, or pressed; directions stay those of the drawing (small motions).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array, Given
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.cells import bases
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.interface.obstacle import Obstacle, vector

OF_CELL = 0.1  # of a cell's size, by which what is above a rim may lie beyond it


def _unit(name: str, value: ArrayLike, size: int) -> Array:
    found = vector(name, value, size)
    largest = np.abs(found).max()
    if not largest > 0.0:
        checks.refuse(name, value, "has no direction")
    found = found / largest  # whose square neither vanishes nor overflows
    return found / np.linalg.norm(found)


def _radius(value: float, inside: bool) -> float:
    checks.boolean("inside", inside)
    return checks.number("radius", value, "give a positive, finite number", above=0.0)


@dataclass(eq=False)
class RigidPlane(Obstacle):
    """A half-space.

    Args:
        point: (gdim,) any point of the surface [length].
        normal: (gdim,) out of the obstacle, towards the body.
        displacement, rotation, pivot, force, moment: (gdim,) or numbers, as of ``Obstacle``.

    Raises:
        ContactInputError: wrong sizes, a zero normal, values that are not finite.

    >>> floor = RigidPlane((0.0, 0.0), (0.0, 2.0))
    >>> distance, direction = floor.clearance(np.array([[3.0, 0.5], [1.0, -0.25]]))
    >>> distance
    array([ 0.5 , -0.25])
    >>> direction[0].tolist()
    [-0.0, -1.0]
    """

    point: Given
    normal: Given

    def __post_init__(self) -> None:
        self.point = vector("point", self.point)
        self.normal = _unit("normal", self.normal, len(self.point))
        self.pose(len(self.point))  # what moves it fits the dimension

    @property
    def middle(self) -> Array:
        return self.point

    def clearance(self, x: Array) -> tuple[Array, Array]:
        return (x - self.point) @ self.normal, np.broadcast_to(-self.normal, x.shape).copy()


@dataclass(eq=False)
class RigidSphere(Obstacle):
    """A ball (a disc in 2D), or with ``inside`` a cavity that holds the body.

    Args:
        centre: (gdim,) [length].
        radius: positive [length].
        inside: the body lies inside.
        displacement, rotation, pivot, force, moment: (gdim,) or numbers, as of ``Obstacle``.

    Raises:
        ContactInputError: wrong sizes, a radius that is not positive.

    >>> points = np.array([[0.0, 0.0, 3.0], [0.0, 1.0, 0.0]])
    >>> RigidSphere((0.0, 0.0, 0.0), 2.0).clearance(points)[0]
    array([ 1., -1.])
    >>> RigidSphere((0.0, 0.0, 0.0), 2.0, inside=True).clearance(points)[0]
    array([-1.,  1.])
    """

    centre: Given
    radius: float
    inside: bool = False

    def __post_init__(self) -> None:
        self.centre = vector("centre", self.centre)
        self.radius = _radius(self.radius, self.inside)
        self.pose(len(self.centre))  # what moves it fits the dimension

    @property
    def middle(self) -> Array:
        return self.centre

    def clearance(self, x: Array) -> tuple[Array, Array]:
        return _round(x - self.centre, self.radius, self.inside)


@dataclass(eq=False)
class RigidCylinder(Obstacle):
    """An endless cylinder in 3D, or with ``inside`` a bore that holds the body.

    Args:
        point: (3,) any point of the axis [length].
        axis: (3,) its direction.
        radius: positive [length].
        inside: the body lies inside.
        displacement, rotation, pivot, force, moment: (gdim,) or numbers, as of ``Obstacle``.

    Raises:
        ContactInputError: wrong sizes, a zero axis, a radius that is not positive.

    >>> bore = RigidCylinder((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 2.0, inside=True)
    >>> distance, direction = bore.clearance(np.array([[1.5, 0.0, 7.0]]))
    >>> distance.item(), direction.tolist()
    (0.5, [[1.0, 0.0, 0.0]])
    """

    point: Given
    axis: Given
    radius: float
    inside: bool = False

    def __post_init__(self) -> None:
        self.point = vector("point", self.point, 3)
        self.axis = _unit("axis", self.axis, 3)
        self.radius = _radius(self.radius, self.inside)
        self.pose(3)  # what moves it fits the dimension

    @property
    def middle(self) -> Array:
        return self.point

    def clearance(self, x: Array) -> tuple[Array, Array]:
        d = x - self.point
        return _round(d - np.outer(d @ self.axis, self.axis), self.radius, self.inside)


@dataclass(eq=False)
class RigidSurface(Obstacle):
    """A surface mesh: the closest point counts, with the normal of its cell; above an edge or a
    corner of the mesh with the way from there, but beyond its rim, where there is no obstacle. A
    rim may lean, as facets do at a plane of symmetry: what is right above it meets its plane.

    Args:
        mesh: a ``Frame`` whose normals point to the body, in 2D to the left of its cells.
        displacement, rotation, pivot, force, moment: (gdim,) or numbers, as of ``Obstacle``.

    Raises:
        ContactInputError: mesh is no ``Frame``.

    >>> ramp = RigidSurface(Frame([[0.0, 0.0], [4.0, 3.0]], [[0, 1]]))  # rises by 3 over 4
    >>> distance, direction = ramp.clearance(np.array([[0.0, 2.5]]))
    >>> distance.round(12).item(), direction.round(12).tolist()
    (2.0, [[0.6, -0.8]])
    >>> ramp.clearance(np.array([[-1.0, 0.0]]))[0].tolist()  # beyond its rim
    [inf]
    >>> roof = RigidSurface(Frame([[1.0, -1.0], [0.0, 0.0], [-1.0, -1.0]], [[1, 0], [2, 1]]))
    >>> roof.clearance(np.array([[0.0, 0.5], [0.3, 0.4]]))[0]
    array([0.5, 0.5])
    """

    mesh: Frame

    def __post_init__(self) -> None:
        checks.instance("mesh", self.mesh, Frame, "give a dolfinx_llm.Frame")
        self.pose(self.gdim)  # what moves it fits the dimension

    @property
    def gdim(self) -> int:
        return self.mesh.gdim

    def clearance(self, x: Array) -> tuple[Array, Array]:
        at = self.mesh.locate(x)
        _, y, tangents = self.mesh.evaluate(at.cell, at.xi)
        normal = bases(tangents)[:, -1]
        distance = np.einsum("ni,ni->n", x - y, normal)
        beside = np.flatnonzero(at.outside > 1e-9)
        rim, out = self.mesh.places.around(at.cell[beside], at.xi[beside])
        # Beyond its rim a surface stops nobody, but what is right above one that leans.
        ends = beside[rim]
        over = np.linalg.norm(x[ends] - y[ends] - distance[ends, None] * normal[ends], axis=1)
        most = self.mesh.turns[at.cell[ends]] * np.abs(distance[ends])
        leaves = (over > most) | (at.outside[ends] > OF_CELL)
        distance[ends[leaves]] = np.inf
        within = beside[~rim]
        arm = x[within] - y[within]
        size = np.linalg.norm(arm, axis=1)
        size[np.einsum("ni,ni->n", arm, out[~rim]) < 0.0] *= -1.0  # inside
        distance[within], normal[within] = size, arm / size[:, None]
        return distance, -normal


def _round(d: Array, radius: float, inside: bool) -> tuple[Array, Array]:
    """Clearance of points at d (n, gdim) from the centre or axis."""
    r = np.linalg.norm(d, axis=1)
    centre = r <= 1e-12 * radius
    if centre.any():
        raise ContactInputError(
            f"{int(centre.sum())} surface node(s) lie at the centre of a rigid obstacle of radius "
            f"{radius:g}: no direction leads out of it. Check positions and units"
        )
    out = d / r[:, None]
    return (radius - r, out) if inside else (r - radius, -out)


@dataclass(eq=False)
class MeanDisplacement(Obstacle):
    """The mean displacement of a surface over its area, prescribed; in the place of an obstacle,
    with ``Tied()``. The surface may deform: what acts on it is a uniform traction, as of a load
    whose size is not known. ``result.resultant`` tells its sum. At finite deformation area and
    traction are those of the drawing, a dead load.

    Args:
        mean: (gdim,) [length], None where a component is free; may be set anew before every solve.
        displacement, rotation, pivot, force, moment: (gdim,) of rigid obstacles, not taken.

    Raises:
        ContactInputError: no component has a number, or what is not taken is given.

    >>> MeanDisplacement((None, 0.1)).axes(2)
    array([[0., 1.]])
    """

    mean: Given

    everywhere = True

    def __post_init__(self) -> None:
        for name in ("displacement", "rotation", "pivot", "force", "moment"):
            if getattr(self, name) is not None:
                checks.refuse(name, getattr(self, name), "not taken beside a mean displacement")
        self.pose(len(checks.items("mean", self.mean, "give numbers, or None where it is free")))

    @property
    def gdim(self) -> int:
        """Dimension of the space, 2 or 3."""
        return len(self.mean)

    def clearance(self, x: Array) -> tuple[Array, Array]:
        """None anywhere; the surface's own normals count.

        Args:
            x: (n, gdim) points [length].
        """
        return np.zeros(len(x)), np.broadcast_to(np.eye(x.shape[1])[0], x.shape)

    def axes(self, gdim: int) -> Array:
        """(c, gdim) of the components that are prescribed.

        Args:
            gdim: dimension of the space.
        """
        return np.eye(gdim)[[value is not None for value in self.mean]]

    def pose(self, gdim: int) -> tuple[tuple[Any, ...], ...]:
        """The mean as displacement, 0 where it is free, and nothing else; see ``Obstacle``.

        Args:
            gdim: dimension of the space.

        Raises:
            ContactInputError: sizes that do not fit, values that are not finite.
        """
        want = f"give {gdim} entries, finite numbers or None where it is free, not all of them None"
        given = checks.items("mean", self.mean, want)
        if len(given) != gdim or gdim not in (2, 3) or all(value is None for value in given):
            checks.refuse("mean", self.mean, want)
        shift = tuple(0.0 if v is None else checks.number("mean", v, want) for v in given)
        turns = 1 if gdim == 2 else 3
        return shift, (0.0,) * turns, (0.0,) * gdim, (None,) * gdim, (None,) * turns


def about_the_mean(mean: MeanDisplacement, pairs: ContactPairs) -> tuple[ContactPairs, Array]:
    """All motions of the pairs' nodes without a mean, as those of a frame with one node less: the
    pairs with their shape functions, and (n - 1, c, gdim) directions. Balance of the frame makes
    forces those of a uniform traction."""
    n, axes, f = len(pairs.nodes), mean.axes(pairs.x.shape[1]), pairs.forces
    last = int(np.argmax(f))
    others, column = np.delete(np.arange(n), last), np.arange(n - 1)
    values = np.concatenate([np.ones(n - 1), -f[others] / f[last]])
    rows = np.concatenate([others, np.full(n - 1, last)])
    N = csr_matrix((values, (rows, np.tile(column, 2))), shape=(n, n - 1))
    base = np.broadcast_to(axes, (n, *axes.shape)).copy()
    return replace(pairs, N=N, base=base), np.broadcast_to(axes, (n - 1, *axes.shape))
