"""Frame design by node positions: a flat frame is moved until it passes the contact patch test.

Section 5 of Rebel, Park and Felippa (2001). The residual (28) is only C0 in the node positions (a
contact point that crosses an edge of the frame kinks it), so a single descent from a prediction
gets stuck. Here many starts descend together, in one NumPy batch, on the residual and the violated
constraints; the best shaped of the frames that pass is chosen.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dolfinx_llm._parallel import ContactError
from dolfinx_llm.frame import Frame, shape_functions, vector_areas

_GRID = 1e-9 / np.sqrt(2.0)  # the search sees plane coordinates and forces rounded to this grid


@dataclass(frozen=True)
class _Scene:
    """Plane problem in scaled coordinates; of a symmetric scene one representative of each orbit."""

    Y: np.ndarray  # (m, 2) predicted nodes
    Z: np.ndarray  # (2 m, n_q) free parameters q to node displacements
    cells: np.ndarray  # (n_cells, k) anticlockwise, those that can hold a point
    orbit: np.ndarray  # (m,) orbit of each node
    x: np.ndarray  # (P, 2) points
    c: np.ndarray  # (2, P) signed and absolute force of each point's orbit
    corners: np.ndarray  # (n_corners, 3) node, next, previous
    bounds: np.ndarray  # (4,) smallest, largest angle [rad], shortest side, least support

    def nodes(self, q: np.ndarray) -> np.ndarray:
        """(B, n_q) parameters to (B, m, 2) node positions."""
        return self.Y + (q @ self.Z.T).reshape(len(q), -1, 2)


def _locate(Y: np.ndarray, cells: np.ndarray, x: np.ndarray):
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
    cross = lambda u, v: u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]  # noqa: E731
    A, H, C = -cross(b, d), cross(s, d) + cross(a, b), cross(s, a)
    eta = -2.0 * C / (H + np.sqrt(np.maximum(H * H - 4.0 * A * C, 0.0)))
    g = a + d * eta[..., None]
    xi = ((s - b * eta[..., None]) * g).sum(axis=-1) / (g * g).sum(axis=-1)
    return cell, np.stack([xi, eta], axis=-1)


_MODES = 0.25 * np.array([[-1, 1, 1, -1], [-1, -1, 1, 1], [1, -1, 1, -1]])


def _scatter(shape: tuple[int, ...], index: tuple, values: np.ndarray) -> np.ndarray:
    """Sum values into an array of zeros at (broadcast) multi-indices."""
    flat = np.broadcast_to(np.ravel_multi_index(np.broadcast_arrays(*index), shape), values.shape)
    sums = np.bincount(flat.ravel(), values.ravel(), minlength=int(np.prod(shape)))
    return sums.reshape(shape)


def _forces(scene: _Scene, Y: np.ndarray):
    """Frame forces (28) and their derivatives by the node positions, for B frames.

    Moving node K changes N_J at a point at rest by -grad N_J N_K.

    Returns:
        (B, 2, n_orbits) residual and support of the orbits (sums over their nodes), and
        (B, 2, n_orbits, 2 m) derivatives.
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


def _shape(scene: _Scene, Y: np.ndarray):
    """Corner angles [rad] and sides of B frames, (B, n_corners) each, and derivatives by Y."""
    i, nxt, prv = scene.corners.T
    e, b = Y[:, nxt] - Y[:, i], Y[:, prv] - Y[:, i]
    angle = np.arctan2(e[..., 0] * b[..., 1] - e[..., 1] * b[..., 0], (e * b).sum(axis=-1))
    side = np.linalg.norm(e, axis=-1)
    perp = lambda v: np.stack([-v[..., 1], v[..., 0]], axis=-1)  # noqa: E731
    ge, gb = -perp(e) / (e * e).sum(-1, keepdims=True), perp(b) / (b * b).sum(-1, keepdims=True)
    u = e / side[..., None]
    shape = (len(Y), len(i), Y.shape[1] * 2)
    row = (np.arange(len(Y))[:, None, None], np.arange(len(i))[:, None])
    col = [2 * j[:, None] + np.arange(2) for j in (nxt, prv, i)]
    dangle = sum(
        _scatter(shape, (*row, c), g) for c, g in zip(col, (ge, gb, -ge - gb), strict=True)
    )
    dside = _scatter(shape, (*row, col[0]), u) + _scatter(shape, (*row, col[2]), -u)
    return angle, side, dangle, dside


def _system(scene: _Scene, q: np.ndarray):
    """Least-squares rows of B frames: residual (28), then every constraint by its violation.

    Returns:
        R (B, n), dR (B, n, n_q), and valid (B,): all cells convex and anticlockwise.
    """
    Y = scene.nodes(q)
    amin, amax, lmin, smin = scene.bounds
    angle, side, dangle, dside = _shape(scene, Y)
    valid = ((angle > 0.02) & (angle < 3.12)).all(axis=1) & (side > 0.02 * lmin).all(axis=1)
    f, df = _forces(scene, np.where(valid[:, None, None], Y, scene.Y))
    size = np.bincount(scene.orbit)
    low, high, short = amin - angle, angle - amax, 1.0 - side / lmin
    weak = (smin - f[:, 1] / size) * _WS
    R = [f[:, 0] / np.sqrt(size), np.maximum(low, 0) - np.maximum(high, 0)]
    R += [0.3*np.maximum(short, 0), np.maximum(weak, 0)]
    turned = (low > 0) | (high > 0)
    dR = [df[:, 0] / np.sqrt(size)[:, None], -dangle * turned[..., None]]
    dR += [-0.3*dside / lmin * (short > 0)[..., None]]
    dR += [-_WS * df[:, 1] / size[:, None] * (weak > 0)[..., None]]
    return np.concatenate(R, axis=1), np.concatenate(dR, axis=1) @ scene.Z, valid
_WS=1.0


def _descend(scene: _Scene, q: np.ndarray, iterations: int, stop: float = 1e-12):
    """Levenberg-Marquardt descent of B starts in one batch.

    Returns:
        (B, n_q) parameters and (B,) largest entry of the rows reached.
    """
    q, mu = q.copy(), np.full(len(q), 1e-2)
    R, J, _ = _system(scene, q)
    F = (R * R).sum(axis=1)
    live = np.arange(len(q))
    F8 = F.copy()
    for it in range(iterations):
        if it%10==9:
            keep=F[live]<0.8*F8[live]; 
            if it<15: keep[:]=True
            F8=F.copy(); live=live[keep]
        if not len(live):
            break
        Jl, Rl = J[live], R[live]
        H = Jl.transpose(0, 2, 1) @ Jl + mu[live, None, None] * np.eye(q.shape[1])
        d = -np.linalg.solve(H, (Jl.transpose(0, 2, 1) @ Rl[..., None]))[..., 0]
        d *= np.minimum(1.0, 0.3 / np.maximum(np.abs(d).max(axis=1, keepdims=True), 1e-300))
        Rn, Jn, valid = _system(scene, q[live] + d)
        Fn = (Rn * Rn).sum(axis=1)
        good = valid & (Fn < F[live])
        ratio = Fn/F[live]
        g = live[good]
        mu[live] *= np.where(good, np.where(ratio < 0.5, 0.2, np.where(ratio<.9,.7,1.5)), 4.0)
        mu = np.maximum(mu, 1e-12)
        q[g], R[g], J[g], F[g] = q[g] + d[good], Rn[good], Jn[good], Fn[good]
        live = live[(np.abs(R[live]).max(axis=1) > stop) & (mu[live] < 1e6)]
    return q, np.abs(R).max(axis=1)
