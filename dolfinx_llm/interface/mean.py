"""The mean displacement of a surface, which a uniform traction brings about."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base import checks
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.interface.obstacle import Obstacle


@dataclass(eq=False)
class MeanDisplacement(Obstacle):
    """The mean displacement of a surface over its area, prescribed; in the place of an obstacle,
    with ``Tied()``. The surface may deform: what acts on it is a uniform traction, as of a load
    whose size is not known. ``result.resultant`` tells its sum.

    Args:
        mean: (gdim,) [length], None where a component is free; may be set anew before every solve.
        displacement, rotation, pivot, force, moment: (gdim,) of rigid obstacles, not taken.

    Raises:
        ContactInputError: no component has a number, or what is not taken is given.

    >>> MeanDisplacement((None, 0.1)).axes(2)
    array([[0., 1.]])
    """

    mean: Any

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

    def clearance(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """None anywhere; the surface's own normals count.

        Args:
            x: (n, gdim) points [length].
        """
        return np.zeros(len(x)), np.broadcast_to(np.eye(x.shape[1])[0], x.shape)

    def axes(self, gdim: int) -> np.ndarray:
        """(c, gdim) of the components that are prescribed.

        Args:
            gdim: dimension of the space.
        """
        return np.eye(gdim)[[value is not None for value in self.mean]]

    def pose(self, gdim: int) -> tuple[tuple, tuple, tuple, tuple, tuple]:
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


def about_the_mean(mean: MeanDisplacement, pairs: ContactPairs) -> tuple[ContactPairs, np.ndarray]:
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
