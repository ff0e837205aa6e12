"""Coulomb's law at the frame's nodes: linearised rows for stick, slip and open.

The paper's (13) says that both bodies slip by the same κ about the frame. Node by node on two
meshes that do not match it cannot hold; read on the frame it can: κ is a field of the frame, the
nodes of both sides follow v + κ and v - κ. Per frame node J, with the tangential force T of side 0
on the frame, the normal force N and the slip δ = 2 (κ - κ_before) of this load step,

    |T| <= μ N;   |T| < μ N: δ = 0;   else T = μ N δ / |δ|.

Against a rigid obstacle each surface node is its own J and δ = κ - κ_before. Plain NumPy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

OPEN, STICK, SLIP = 0, 1, 2
CLOSED = 3  # in contact, without friction


@dataclass(frozen=True, eq=False)
class FrictionRows:
    """C_T T + C_δ δ + C_N N = rhs at n nodes, d tangents."""

    status: np.ndarray  # (n,) OPEN, STICK, SLIP
    C_T: np.ndarray  # (n, d, d)
    C_delta: np.ndarray  # (n, d, d) [force / length]
    C_N: np.ndarray  # (n, d)
    rhs: np.ndarray  # (n, d) [force]

    def tied(self, speaker: np.ndarray, unheld: np.ndarray, c: float) -> FrictionRows:
        """The same, but that nodes for which others speak slip as those do: their δ, taken relative
        to it, vanishes; and that nodes which no force reaches do not slip.

        Args:
            speaker: (n,) of ``speakers``.
            unheld: (n,) of the function of that name.
            c: size of their rows [force / length].
        """
        own = speaker == np.arange(len(speaker))
        kept = (own & ~unheld)[:, None, None]
        unit = np.eye(self.rhs.shape[1])
        return FrictionRows(
            np.where(unheld, OPEN, self.status[speaker]),
            C_T=np.where(kept, self.C_T, 0.0),
            C_delta=np.where(kept, self.C_delta, c * unit),
            C_N=np.where(kept[:, 0], self.C_N, 0.0),
            rhs=np.where(kept[:, 0], self.rhs, 0.0),
        )


def _length(a: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a, axis=1)


def projection_miss(
    T: np.ndarray, N: np.ndarray, delta: np.ndarray, mu: float, c: np.ndarray
) -> np.ndarray:
    """(n,) distance of T from the projection of z = T + c δ on the disc of radius μ N [force]."""
    z, s = T + c[:, None] * delta, mu * np.maximum(N, 0.0)
    size = _length(z)
    return _length(T - z * np.minimum(1.0, s / np.maximum(size, 1e-300))[:, None])


def newton_rows(
    T: np.ndarray, N: np.ndarray, delta: np.ndarray, mu: float, c: np.ndarray
) -> FrictionRows:
    """Semismooth Newton on T = projection of z = T + c δ, in the stabilised form of Hüeber, Stadler
    and Wohlmuth, SIAM J. Sci. Comput. 30 (2008) 572-596.

    Args:
        T: (n, d) tangential forces [force].
        N: (n,) normal forces [force].
        delta: (n, d) slip of this load step [length].
        mu: coefficient of friction.
        c: (n,) positive [force / length]; the solution does not depend on it.

    >>> T, N, delta = np.array([[1.0], [4.0], [1.0]]), np.array([10.0, 10.0, 0.0]), np.zeros((3, 1))
    >>> newton_rows(T, N, delta, 0.3, np.ones(3)).status.tolist() == [STICK, SLIP, OPEN]
    True
    """
    n, d = T.shape
    z, s = T + c[:, None] * delta, mu * np.maximum(N, 0.0)
    size, t = _length(z), _length(T)
    status = np.where(N <= 0.0, OPEN, np.where(size < s, STICK, SLIP))
    safe = np.maximum(size, 1e-300)
    direction = z / safe[:, None]
    e = np.minimum(s / safe, 1.0)
    cosine = np.einsum("ni,ni->n", T, z) / np.maximum(t * safe, 1e-300)
    beta = 1.0 / (1.0 - np.minimum(cosine, 0.0) * np.minimum(t / np.maximum(s, 1e-300), 1.0))
    largest = np.maximum(np.maximum(s, t), 1e-300)[:, None, None]
    outer = T[:, :, None] * direction[:, None, :] / largest
    M = e[:, None, None] * (np.eye(d) - beta[:, None, None] * outer)
    slip = (status == SLIP)[:, None, None]
    stick = (status == STICK)[:, None, None]
    unit, c = np.broadcast_to(np.eye(d), (n, d, d)), c[:, None, None]
    return FrictionRows(
        status,
        C_T=np.where(stick, 0.0, np.where(slip, unit - M, unit)),
        C_delta=np.where(stick, c * unit, np.where(slip, -c * M, 0.0)),
        C_N=np.where(slip[:, 0], -mu * direction, 0.0),
        rhs=np.where(slip[:, 0], -np.einsum("nij,nj->ni", M, z), 0.0),
    )


def switch_rows(T, N, delta, mu: float, c: np.ndarray, before: np.ndarray) -> FrictionRows:
    """The paper's switch: stick until |T| exceeds μ N, slip until the slip turns round.

    A node that begins to slip takes the direction of its force (16), one that slips that of its
    slip (17), both of the last iterate; the size of the force follows N of this one.

    Args:
        T, N, delta, mu, c: as in ``newton_rows``.
        before: (n,) status in the last iterate.
    """
    n, d = T.shape
    was_slip = before == SLIP
    force, slip = _length(T), _length(delta)
    turned = np.einsum("ni,ni->n", T, delta) < 0.0
    slips = np.where(was_slip, ~turned & (slip > 0.0), force > mu * np.maximum(N, 0.0))
    status = np.where(N <= 0.0, OPEN, np.where(slips, SLIP, STICK))
    direction = np.where(
        was_slip[:, None],
        delta / np.maximum(slip, 1e-300)[:, None],
        T / np.maximum(force, 1e-300)[:, None],
    )
    stick = (status == STICK)[:, None, None]
    unit, c = np.broadcast_to(np.eye(d), (n, d, d)), c[:, None, None]
    return FrictionRows(
        status,
        C_T=np.where(stick, 0.0, unit),
        C_delta=np.where(stick, c * unit, 0.0),
        C_N=np.where((status == SLIP)[:, None], -mu * direction, 0.0),
        rhs=np.zeros((n, d)),
    )
