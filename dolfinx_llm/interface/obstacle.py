"""What all rigid obstacles share: where they are, and what moves or presses them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array, Given
from dolfinx_llm.base.errors import ContactInputError


def vector(name: str, value: ArrayLike, size: int | None = None) -> Array:
    """A finite vector of 2 or 3 numbers, or of ``size``."""
    want = f"give {size if size else '2 or 3'} numbers, which must be finite"
    found = checks.array(name, value, (None,), want)
    if len(found) not in (2, 3) or (size and len(found) != size):
        checks.refuse(name, value, want)
    return found


@dataclass(eq=False)
class Obstacle:
    """What all obstacles share, and the base of your own: write ``clearance``.

    All of the arguments may be set anew before every solve, those of its shape and place, too. At
    small deformation the latter, and the pivot of a rigid end under a moment, draw it anew: contact
    is found from there, and its state before is forgotten, as where a mesh was moved; what moves
    between load steps has a displacement and a rotation. Motions are small: directions in which
    contact forces act stay those of the drawing, and a point x of the obstacle moves by
    displacement + rotation × (x - pivot). About its own axis a sphere or cylinder may turn by any
    angle, which drags with friction what it touches. At finite deformation all motions are finite.

    Args:
        displacement: (gdim,) motion since the drawing [length]; None: at rest.
        rotation: since the drawing: in 2D the angle, counter-clockwise, in 3D the (3,) rotation
            vector, axis times angle [rad]; None: it does not turn.
        pivot: (gdim,) the point about which it turns, as drawn [length]; None: its centre, or the
            point that defines it; the origin for your own.
        force: (gdim,) force on the obstacle instead of a displacement [force], with None where the
            displacement is prescribed, e.g. (None, -10.0): pressed down with 10, held sideways.
            What it does not press against it does not reach. None: no force is prescribed. With
            ``Tied()`` the obstacle is the rigid end of a body, with its force or motion.
        moment: about the pivot instead of a rotation [force length], of a rigid end alone: in 2D a
            number, in 3D (3,) with None where the rotation is prescribed. None: the rotation is.

    >>> class Sine(Obstacle):
    ...     "The floor y = sin(x) / 10."
    ...
    ...     def clearance(self, x):
    ...         slope = 0.1 * np.cos(x[:, 0])  # of the floor below a point
    ...         normal = np.column_stack([slope, -np.ones(len(x))])
    ...         length = np.linalg.norm(normal, axis=1)
    ...         return (x[:, 1] - 0.1 * np.sin(x[:, 0])) / length, normal / length[:, None]
    >>> Sine().clearance(np.array([[0.0, 0.5]]))[0].round(6)
    array([0.497519])
    >>> Sine(rotation=0.1, pivot=(1.0, 0.0)).motion(np.array([[3.0, 0.0]]))
    array([[0. , 0.2]])
    """

    displacement: Given = field(default=None, kw_only=True)  # (gdim,) [length]
    rotation: Given = field(default=None, kw_only=True)  # angle, (3,) [rad]
    pivot: Given = field(default=None, kw_only=True)  # (gdim,) [length]
    force: Given = field(default=None, kw_only=True)  # (gdim,) [force]
    # about the pivot: a number, in 3D (3,) [force length]
    moment: Given = field(default=None, kw_only=True)

    everywhere = False  # all of the surface takes part, with normals of its own

    def clearance(self, x: Array) -> tuple[Array, Array]:
        """Distance of points to the surface, and the direction into the obstacle.

        It is asked in every solve, for the surface's nodes as drawn: contact is found anew where
        that has changed. A linear estimate of the distance along the direction is enough where
        nodes are near. At finite deformation it is asked in every
        iteration, and for its derivatives at points beside the nodes.

        Args:
            x: (n, gdim) points of a body where the obstacle is as drawn [length].

        Returns:
            (n,) distance, negative inside the obstacle, inf where there is none of it [length], and
            (n, gdim) unit vectors into it.
        """
        raise NotImplementedError(f"{type(self).__name__} must define clearance(x)")

    @property
    def gdim(self) -> int | None:
        """Dimension of the space, 2 or 3, that of ``middle``; None: any."""
        return None if self.middle is None else len(self.middle)

    @property
    def middle(self) -> Array | None:
        """(gdim,) the point about which it turns where no ``pivot`` is given; None: the origin."""
        return None

    def motion(self, x: Array) -> Array:
        """Prescribed motion of points of the obstacle since the drawing.

        Args:
            x: (n, gdim) the points, as drawn [length].

        Returns:
            (n, gdim) [length]; zeros where nothing is prescribed.

        Raises:
            ContactInputError: sizes that do not fit, values that are not finite.
        """
        return np.array(self.pose(x.shape[1])[0]) + self.turning(x)

    def turning(self, x: Array) -> Array:
        """The part of ``motion`` that comes of the rotation, rotation × (x - pivot).

        Args:
            x: (n, gdim) the points, as drawn [length].

        Returns:
            (n, gdim) [length].
        """
        _, turn, pivot, *_ = self.pose(x.shape[1])
        return turned(x - np.array(pivot), np.array(turn))

    def pose(self, gdim: int) -> tuple[tuple[Any, ...], ...]:
        """Displacement, rotation, pivot, force and moment as they are now, as numbers; forces and
        moments None where the motion is prescribed.

        Args:
            gdim: dimension of the space, 2 or 3.

        Raises:
            ContactInputError: sizes that do not fit, values that are not finite.
        """
        force, moment = self._forces("force", gdim), self._forces("moment", 1 if gdim == 2 else 3)
        zeros = (0.0,) * gdim
        shift, pivot, turn = zeros, zeros, (0.0,) * (1 if gdim == 2 else 3)
        if self.displacement is not None:
            shift = tuple(vector("displacement", self.displacement, gdim).tolist())
        about = self.middle if self.pivot is None else self.pivot
        if about is not None:
            pivot = tuple(vector("pivot", about, gdim).tolist())
        if self.rotation is not None and gdim == 2:
            turn = (checks.number("rotation", self.rotation, "give the angle, a finite number"),)
        elif self.rotation is not None:
            turn = tuple(vector("rotation", self.rotation, 3).tolist())
        for names, moves, forces in (
            ("displacement force", shift, force), ("rotation moment", turn, moment)
        ):  # fmt: skip
            if found := [k for k, f in enumerate(forces) if f is not None and moves[k]]:
                motion, given = names.split()
                raise ContactInputError(
                    f"{motion}={moves} and {given}={forces}: component {found[0]} has both; where "
                    f"a {given} is given the {motion} is found: leave 0 there"
                )
        return shift, turn, pivot, force, moment

    def _forces(self, name: str, size: int) -> tuple[float | None, ...]:
        """``force`` or ``moment``, component by component."""
        value = getattr(self, name)
        if value is None:
            return (None,) * size
        want = f"give {size} entries, finite numbers or None where the motion is prescribed"
        if size == 1:
            return (checks.number(name, value, "give a finite number, or None"),)
        given = checks.items(name, value, want)
        if len(given) != size:
            checks.refuse(name, value, want)
        return tuple(None if f is None else checks.number(name, f, want) for f in given)


def turned(arm: Array, turn: Array) -> Array:
    """(n, gdim) motion of points at arms (n, gdim) from the pivot, turned by a small angle (1,) or
    rotation vector (3,)."""
    if arm.shape[1] == 2:
        return turn[0] * np.column_stack([-arm[:, 1], arm[:, 0]])
    return np.cross(turn, arm)


@dataclass(frozen=True, eq=False)
class Swings:
    """How a rigid end turns with its d unknowns, which are lengths: angles times ``size``."""

    turns: Array  # (d, 1), (d, 3) of the size times the angle or rotation vector
    motions: Array  # (n, d, gdim) by which it moves the points of the pairs
    size: float  # of the arms [length]

    @classmethod
    def of(cls, obstacle: Obstacle, x: Array, turns: Array) -> Swings:
        """Of an obstacle's points x (n, gdim)."""
        arm = x - np.array(obstacle.pose(x.shape[1])[2])
        size = float(np.linalg.norm(arm, axis=1).max()) or 1.0
        motions = [turned(arm / size, turn) for turn in turns]
        return cls(turns, np.stack(motions, axis=1), size)

    def rotation(self, w: Array) -> Array:
        """(1,), (3,) of unknowns (d,) [rad]."""
        return w @ self.turns / self.size
