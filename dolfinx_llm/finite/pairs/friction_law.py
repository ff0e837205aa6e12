"""Coulomb's law at pairs of a moving frame, without a base of the tangent plane. Plain NumPy.

With the normal n, P = 1 - n nᵀ, the tangential force tau that a node exerts on the frame, the way
sigma that it has gone there, c > 0 and the bound b of |tau|,

    z = P (tau + c sigma);   stick, |z| <= b: P sigma = 0;   slip: tau = b z / |z|.

Each case has gdim equations: where a node sticks n·tau = 0 is one of them, where it slips it
follows. All are divided by c where they are forces, so that what is left is a length.

Far from the solution the derivative of slip is that of Hüeber, Stadler and Wohlmuth (see
``laws.coulomb``), which holds pairs back by the part of b that tau is short of: the exact one turns
tau round for ever where many pairs begin to slip. It makes slip converge linearly, though, so that
near the solution, where pairs stand, the exact one takes its place: the same where tau = b z / |z|.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.laws.coulomb import AT_LIMIT, stable_slip

LEVEL = 1e-6  # part of a prescribed direction in the tangent plane that is none


@dataclass(frozen=True, eq=False)
class FrictionRows:
    """The law at k pairs, and its derivatives."""

    rest: Array  # (k, gdim) what is left [length]
    by_force: Array  # (k, gdim, gdim) derivative by tau [length / force]
    by_slip: Array  # (k, gdim, gdim) by sigma
    by_normal: Array  # (k, gdim, gdim) by n [length]
    by_bound: Array  # (k, gdim) by b [length / force]

    def moved(self, tau: Array, sigma: Array, bound: Array) -> FrictionRows:
        """The same tangents where forces (k, gdim), ways (k, gdim) and bounds (k,) have changed."""
        changes = np.einsum("kij,kj->ki", self.by_force, tau)
        changes += np.einsum("kij,kj->ki", self.by_slip, sigma) + self.by_bound * bound[:, None]
        return replace(self, rest=self.rest + changes)


def sticks(
    normal: Array,
    tau: Array,
    sigma: Array,
    bound: Array,
    c: float,
    slipped: Array,
) -> Array:
    """(k,) which pairs stick: |z| <= b, or less by rounding for those that have slipped.

    Args:
        normal: (k, gdim) unit vectors.
        tau: (k, gdim) tangential forces [force].
        sigma: (k, gdim) ways [length].
        bound: (k,) of |tau| [force].
        c: positive [force / length]; the solution does not depend on it.
        slipped: (k,) which slipped in the last iterate.
    """
    z = in_plane(normal, tau + c * sigma)
    return np.linalg.norm(z, axis=1) <= bound * np.where(slipped, 1.0 - AT_LIMIT, 1.0 + AT_LIMIT)


def friction_rows(
    normal: Array,
    tau: Array,
    sigma: Array,
    bound: Array,
    c: float,
    stick: Array,
    prescribed: Array,
    yielding: Array,
    exact: bool = False,
) -> FrictionRows:
    """The law and its derivatives.

    Where supports prescribe a component of sigma, friction in stick would be what supports take as
    well: there is none in that direction.

    Args:
        normal, tau, sigma, bound, c: as of ``sticks``.
        stick: (k,) which pairs stick.
        prescribed: (k, gdim) which components of sigma no free coordinate changes.
        yielding: (k, gdim, gdim) by how much stick yields to changes of tau [length / force].
        exact: whether to take the exact derivative of slip.
    """
    unit, nn = np.eye(normal.shape[1]), normal[:, :, None] * normal[:, None, :]
    P, stick = unit - nn, stick[:, None, None]
    # Stick: Q sigma + (1 - Q) tau / c, Q = P without what is prescribed.
    Q = P - _span(P, prescribed)
    rest = np.einsum("kij,kj->ki", Q, sigma - tau / c) + tau / c
    by_normal = _turned(normal, sigma - tau / c)
    # Slip: (tau - b d) / c, d = z / |z|.
    w = tau + c * sigma
    z = in_plane(normal, w)
    d = z / np.maximum(np.linalg.norm(z, axis=1), 1e-300)[:, None]
    M = stable_slip(bound[:, None] * d if exact else tau, z, bound)
    slid = (tau - bound[:, None] * d) / c
    return FrictionRows(
        rest=np.where(stick[:, 0], rest, slid),
        by_force=np.where(stick, (unit - Q) / c - Q @ yielding @ Q, (unit - M @ P) / c),
        by_slip=np.where(stick, Q, -M @ P),
        by_normal=np.where(stick, by_normal, -M @ _turned(normal, w) / c),
        by_bound=np.where(stick[:, 0], 0.0, -d / c),
    )


def in_plane(normal: Array, w: Array) -> Array:
    """(k, gdim) P w."""
    return w - np.einsum("ki,ki->k", normal, w)[:, None] * normal


def _turned(normal: Array, w: Array) -> Array:
    """(k, gdim, gdim) derivative of P w by n."""
    along = np.einsum("ki,ki->k", normal, w)[:, None, None] * np.eye(normal.shape[1])
    return -along - normal[:, :, None] * w[:, None, :]


def _span(P: Array, prescribed: Array) -> Array:
    """(k, gdim, gdim) projections on what of the prescribed axes lies in the tangent planes."""
    if not prescribed.any():
        return np.zeros_like(P)
    inside = P * prescribed[:, None, :]  # P times each of the axes
    inside = inside * (np.linalg.norm(inside, axis=1) > LEVEL)[:, None]
    return inside @ np.linalg.pinv(inside, rcond=LEVEL)
