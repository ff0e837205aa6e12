"""The search for a frame that passes: many starts descend together, in one NumPy batch.

Rows of its least squares are the residual (28), in the frame's plane, and the violated constraints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.cells import cross_plane, shape_functions

_SPREADS = (0.2, 0.3, 0.4, 0.5, 0.6)  # random starts: standard deviation over local side length
# Linear and bilinear parts of the quad's map p = mean + a xi + b eta + d xi eta.
_MODES = 0.25 * np.array([[-1, 1, 1, -1], [-1, -1, 1, 1], [1, -1, 1, -1]])


@dataclass(frozen=True, eq=False)
class Scene:
    """Plane problem, frame scaled to size 1; of mirrored points one representative."""

    Y: Array  # (m, 2) predicted nodes
    Z: Array  # (2 m, n_q) free parameters q to node displacements
    cells: Array  # (n_cells, k) anticlockwise, those that can hold a point
    orbit: Array  # (m,) orbit of each node
    x: Array  # (P, 2) points
    c: Array  # (2, P) signed and absolute force of each point's orbit
    corners: Array  # (n_corners, 3) node, next, previous
    bounds: Array  # (4,) smallest, largest angle [rad], shortest side, least support

    def nodes(self, q: Array) -> Array:
        """(B, n_q) parameters to (B, m, 2) node positions."""
        return self.Y + (q @ self.Z.T).reshape(len(q), -1, 2)


def _locate(Y: Array, cells: Array, x: Array) -> tuple[Array, Array]:
    """Cell (B, P) and reference coordinates (B, P, 2) of points in B frames of convex cells."""
    p = Y[:, cells]
    e = np.roll(p, -1, axis=2) - p
    n = np.stack([-e[..., 1], e[..., 0]], axis=-1) / np.linalg.norm(e, axis=-1, keepdims=True)
    inside = np.einsum("pi,bcki->bpck", x, n, optimize=True)
    inside -= np.einsum("bcki,bcki->bck", n, p)[:, None]
    cell = inside.min(axis=3).argmax(axis=2)
    p = np.take_along_axis(p, cell[:, :, None, None], axis=1)
    if cells.shape[1] == 3:
        T = np.stack([p[:, :, 1] - p[:, :, 0], p[:, :, 2] - p[:, :, 0]], axis=-1)
        return cell, np.linalg.solve(T, (x - p[:, :, 0])[..., None])[..., 0]
    # Inverse of the bilinear map in closed form: s = a xi + b eta + d xi eta.
    s = x - p.mean(axis=2)
    a, b, d = (np.tensordot(g, p, ([0], [2])) for g in _MODES)
    A, H, C = -cross_plane(b, d), cross_plane(s, d) + cross_plane(a, b), cross_plane(s, a)
    eta = -2.0 * C / (H + np.sqrt(np.maximum(H * H - 4.0 * A * C, 0.0)))
    g = a + d * eta[..., None]
    xi = ((s - b * eta[..., None]) * g).sum(axis=-1) / (g * g).sum(axis=-1)
    return cell, np.stack([xi, eta], axis=-1)


def _scatter(shape: tuple[int, ...], index: tuple[Any, ...], values: Array) -> Array:
    """Sum values into an array of zeros at (broadcast) multi-indices."""
    flat = np.broadcast_to(np.ravel_multi_index(np.broadcast_arrays(*index), shape), values.shape)
    sums = np.bincount(flat.ravel(), values.ravel(), minlength=int(np.prod(shape)))
    return sums.reshape(shape)


def frame_forces(scene: Scene, Y: Array) -> tuple[Array, Array]:
    """Frame forces (28) and their derivatives by the node positions, for B frames.

    Moving node K changes N_J at a point at rest by -grad N_J N_K.

    Returns:
        (B, 2, n_orbits) residual and support of the orbits (sums over their nodes), and
        (B, 2, n_orbits, 2 m) derivatives by Y.
    """
    cell, xi = _locate(Y, scene.cells, scene.x)
    (B, P), k = cell.shape, scene.cells.shape[1]
    N, dN = (a.reshape(B, P, k, -1) for a in shape_functions(k, xi.reshape(-1, 2)))
    N, nodes = N[..., 0], scene.cells[cell]
    t = np.einsum("bpkd,bpki->bpid", dN, Y[np.arange(B)[:, None, None], nodes])
    G = dN @ np.linalg.inv(t)
    J = -G[:, :, :, None, :] * N[:, :, None, :, None]
    row, b = scene.orbit[nodes], np.arange(B)[:, None, None]
    n = scene.orbit.max() + 1
    col = 2 * nodes[:, :, None, :, None] + np.arange(2)
    f, df = [], []
    for c in scene.c:
        f.append(_scatter((B, n), (b, row), c[:, None] * N))
        index = (b[..., None, None], row[..., None, None], col)
        df.append(_scatter((B, n, Y.shape[1] * 2), index, c[:, None, None, None] * J))
    return np.stack(f, axis=1), np.stack(df, axis=1)


def cell_shapes(scene: Scene, Y: Array) -> tuple[Array, Array, Array, Array]:
    """Corner angles [rad] and sides of B frames, (B, n_corners), and derivatives by q."""
    i, nxt, prv = scene.corners.T
    e, b = Y[:, nxt] - Y[:, i], Y[:, prv] - Y[:, i]
    angle = np.arctan2(cross_plane(e, b), (e * b).sum(axis=-1))
    side = np.linalg.norm(e, axis=-1)
    perp = np.array([[0.0, 1.0], [-1.0, 0.0]])
    ge, gb = -e @ perp / (e * e).sum(-1, keepdims=True), b @ perp / (b * b).sum(-1, keepdims=True)
    Z = scene.Z.reshape(Y.shape[1], 2, -1)
    d = np.concatenate([Z[nxt] - Z[i], Z[prv] - Z[i]], axis=1)  # (n_corners, 4, n_q) of e and b
    g = np.concatenate([ge, gb], axis=-1).swapaxes(0, 1)
    dangle = (g @ d).swapaxes(0, 1)
    dside = ((e / side[..., None]).swapaxes(0, 1) @ d[:, :2]).swapaxes(0, 1)
    return angle, side, dangle, dside


def least_squares(scene: Scene, q: Array) -> tuple[Array, Array, Array]:
    """Least-squares rows of B frames: residual (28), then every constraint by its violation.

    Returns:
        R (B, n), dR (B, n, n_q), and valid (B,): all cells convex and anticlockwise.
    """
    Y = scene.nodes(q)
    amin, amax, lmin, smin = scene.bounds
    angle, side, dangle, dside = cell_shapes(scene, Y)
    valid = ((angle > 0.02) & (angle < 3.12)).all(axis=1) & (side > 0.02 * lmin).all(axis=1)
    f, df = frame_forces(scene, np.where(valid[:, None, None], Y, scene.Y))
    df, size = df @ scene.Z, np.bincount(scene.orbit)
    low, high, short = amin - angle, angle - amax, 0.3 * (1.0 - side / lmin)
    weak = smin - f[:, 1] / size
    R = [f[:, 0] / np.sqrt(size), np.maximum(low, 0.0) - np.maximum(high, 0.0)]
    R += [np.maximum(short, 0.0), np.maximum(weak, 0.0)]
    dR = [df[:, 0] / np.sqrt(size)[:, None], -dangle * ((low > 0) | (high > 0))[..., None]]
    dR += [-0.3 / lmin * dside * (short > 0)[..., None]]
    dR += [-df[:, 1] / size[:, None] * (weak > 0)[..., None]]
    return np.concatenate(R, axis=1), np.concatenate(dR, axis=1), valid


def random_starts(scene: Scene, n: int, rng: np.random.Generator) -> Array:
    """(n, n_q) random starts, drawn towards the prediction until all cells are convex."""
    spread = np.resize(_SPREADS, n)[:, None]
    q = rng.normal(size=(n, scene.Z.shape[1])) * spread
    bad = np.arange(n)
    for _ in range(30):
        angle = cell_shapes(scene, scene.nodes(q[bad]))[0]
        bad = bad[((angle < 0.1) | (angle > 3.04)).any(axis=1)]
        if not len(bad):
            return q
        q[bad] *= 0.85
    q[bad] = 0.0
    return q


def descend(scene: Scene, q: Array, iterations: int = 80) -> tuple[Array, Array]:
    """Levenberg-Marquardt descent of B starts in one batch; starts that stall are dropped.

    Returns:
        (B, n_q) parameters and (B,) largest entry of the rows of ``least_squares`` reached.
    """
    q, mu, live = q.copy(), np.full(len(q), 1e-2), np.arange(len(q))
    R, J, _ = least_squares(scene, q)
    F = (R * R).sum(axis=1)
    past = F.copy()
    for i in range(iterations):
        if i and i % 10 == 0:
            live = live[F[live] < 0.8 * past[live]]
        if i % 10 == 0:
            past = F.copy()
        if not len(live):
            break
        JT = J[live].transpose(0, 2, 1)
        H = JT @ J[live] + mu[live, None, None] * np.eye(q.shape[1])
        d = -np.linalg.solve(H, JT @ R[live][..., None])[..., 0]
        d *= np.minimum(1.0, 1.0 / np.maximum(np.abs(d).max(axis=1, keepdims=True), 1e-300))
        Rn, Jn, valid = least_squares(scene, q[live] + d)
        Fn = (Rn * Rn).sum(axis=1)
        ratio = Fn / np.maximum(F[live], 1e-300)
        good = valid & (ratio < 1.0)
        factor = np.select([~good, ratio < 0.5, ratio < 0.9], [4.0, 0.2, 0.7], 1.5)
        mu[live] = np.maximum(mu[live] * factor, 1e-12)
        g = live[good]
        q[g], R[g], J[g], F[g] = q[g] + d[good], Rn[good], Jn[good], Fn[good]
        live = live[(np.abs(R[live]).max(axis=1) > 1e-8) & (mu[live] < 1e6)]
    return q, np.abs(R).max(axis=1)


def polish(scene: Scene, Y: Array, Z: Array, steps: int = 8) -> tuple[Array, float]:
    """Least-norm Newton steps on (28) with the exact positions: best nodes and their residual."""
    best, least = Y, np.inf
    for _ in range(steps):
        f, df = frame_forces(scene, Y[None])
        r = f[0, 0]
        if np.abs(r).max() < least:
            best, least = Y, np.abs(r).max()
        if least < 1e-16:
            break
        Y = Y - (Z @ np.linalg.lstsq(df[0, 0] @ Z, r, rcond=1e-10)[0]).reshape(-1, 2)
        if np.abs(Y - best).max() > 1e-3 or not (cell_shapes(scene, Y[None])[0] > 0.02).all():
            break
    return best, least
