"""Frame design by node positions: a flat frame is moved until it passes the contact patch test.

Section 5 of Rebel, Park and Felippa (2001). The residual (28) is only C0 in the node positions (a
contact point that crosses an edge of the frame kinks it), so a single descent from a prediction
gets stuck. Here many starts descend together, in one NumPy batch, on the residual and the violated
constraints; the best shaped of the frames that pass is chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import progress
from dolfinx_llm.design.arguments import position_arguments
from dolfinx_llm.geometry.cells import shape_functions, vector_areas
from dolfinx_llm.geometry.frame import Frame

_GRID = 1e-10 / np.sqrt(2.0)  # the search sees plane coordinates and forces rounded to this grid
_SAME = 1e-9  # points closer than this (frame of size 1) are images of each other
_SPREADS = (0.2, 0.3, 0.4, 0.5, 0.6)  # random starts: standard deviation over local side length
_SUPPORT = 0.02  # least force that reaches a frame node, over the mean of all nodes
_MARGIN = 1e-3  # [rad, relative] by which the search stays inside angle and side bounds
_RANK = 0.02  # least ratio of the singular values of L_b
# Linear and bilinear parts of the quad's map p = mean + a xi + b eta + d xi eta.
_MODES = 0.25 * np.array([[-1, 1, 1, -1], [-1, -1, 1, 1], [1, -1, 1, -1]])

# Mirrors of a scene: signs (2,) of the axes, images of the nodes (m,) and of the points (P,).
_Group = list[tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False)
class _Scene:
    """Plane problem, frame scaled to size 1; of mirrored points one representative."""

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


def _locate(Y: np.ndarray, cells: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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


def _scatter(shape: tuple[int, ...], index: tuple, values: np.ndarray) -> np.ndarray:
    """Sum values into an array of zeros at (broadcast) multi-indices."""
    flat = np.broadcast_to(np.ravel_multi_index(np.broadcast_arrays(*index), shape), values.shape)
    sums = np.bincount(flat.ravel(), values.ravel(), minlength=int(np.prod(shape)))
    return sums.reshape(shape)


def _forces(scene: _Scene, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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


def _shape(scene: _Scene, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Corner angles [rad] and sides of B frames, (B, n_corners), and derivatives by q."""
    i, nxt, prv = scene.corners.T
    e, b = Y[:, nxt] - Y[:, i], Y[:, prv] - Y[:, i]
    angle = np.arctan2(e[..., 0] * b[..., 1] - e[..., 1] * b[..., 0], (e * b).sum(axis=-1))
    side = np.linalg.norm(e, axis=-1)
    perp = np.array([[0.0, 1.0], [-1.0, 0.0]])
    ge, gb = -e @ perp / (e * e).sum(-1, keepdims=True), b @ perp / (b * b).sum(-1, keepdims=True)
    Z = scene.Z.reshape(Y.shape[1], 2, -1)
    d = np.concatenate([Z[nxt] - Z[i], Z[prv] - Z[i]], axis=1)  # (n_corners, 4, n_q) of e and b
    g = np.concatenate([ge, gb], axis=-1).swapaxes(0, 1)
    dangle = (g @ d).swapaxes(0, 1)
    dside = ((e / side[..., None]).swapaxes(0, 1) @ d[:, :2]).swapaxes(0, 1)
    return angle, side, dangle, dside


def _system(scene: _Scene, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Least-squares rows of B frames: residual (28), then every constraint by its violation.

    Returns:
        R (B, n), dR (B, n, n_q), and valid (B,): all cells convex and anticlockwise.
    """
    Y = scene.nodes(q)
    amin, amax, lmin, smin = scene.bounds
    angle, side, dangle, dside = _shape(scene, Y)
    valid = ((angle > 0.02) & (angle < 3.12)).all(axis=1) & (side > 0.02 * lmin).all(axis=1)
    f, df = _forces(scene, np.where(valid[:, None, None], Y, scene.Y))
    df, size = df @ scene.Z, np.bincount(scene.orbit)
    low, high, short = amin - angle, angle - amax, 0.3 * (1.0 - side / lmin)
    weak = smin - f[:, 1] / size
    R = [f[:, 0] / np.sqrt(size), np.maximum(low, 0.0) - np.maximum(high, 0.0)]
    R += [np.maximum(short, 0.0), np.maximum(weak, 0.0)]
    dR = [df[:, 0] / np.sqrt(size)[:, None], -dangle * ((low > 0) | (high > 0))[..., None]]
    dR += [-0.3 / lmin * dside * (short > 0)[..., None]]
    dR += [-df[:, 1] / size[:, None] * (weak > 0)[..., None]]
    return np.concatenate(R, axis=1), np.concatenate(dR, axis=1), valid


def _descend(scene: _Scene, q: np.ndarray, iterations: int = 80) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt descent of B starts in one batch; starts that stall are dropped.

    Returns:
        (B, n_q) parameters and (B,) largest entry of the rows of ``_system`` reached.
    """
    q, mu, live = q.copy(), np.full(len(q), 1e-2), np.arange(len(q))
    R, J, _ = _system(scene, q)
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
        Rn, Jn, valid = _system(scene, q[live] + d)
        Fn = (Rn * Rn).sum(axis=1)
        ratio = Fn / np.maximum(F[live], 1e-300)
        good = valid & (ratio < 1.0)
        factor = np.select([~good, ratio < 0.5, ratio < 0.9], [4.0, 0.2, 0.7], 1.5)
        mu[live] = np.maximum(mu[live] * factor, 1e-12)
        g = live[good]
        q[g], R[g], J[g], F[g] = q[g] + d[good], Rn[good], Jn[good], Fn[good]
        live = live[(np.abs(R[live]).max(axis=1) > 1e-8) & (mu[live] < 1e6)]
    return q, np.abs(R).max(axis=1)


def _starts(scene: _Scene, n: int, rng: np.random.Generator) -> np.ndarray:
    """(n, n_q) random starts, drawn towards the prediction until all cells are convex."""
    spread = np.resize(_SPREADS, n)[:, None]
    q = rng.normal(size=(n, scene.Z.shape[1])) * spread
    bad = np.arange(n)
    for _ in range(30):
        angle = _shape(scene, scene.nodes(q[bad]))[0]
        bad = bad[((angle < 0.1) | (angle > 3.04)).any(axis=1)]
        if not len(bad):
            return q
        q[bad] *= 0.85
    q[bad] = 0.0
    return q


def _outline(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges (n, 2) that belong to one cell, lower node first and sorted; and their cells (n,)."""
    edges = np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, first, count = np.unique(edges, axis=0, return_index=True, return_counts=True)
    return edges[count == 1], first[count == 1] // cells.shape[1]


def _plane(frame: Frame) -> tuple[np.ndarray, float, np.ndarray]:
    """Centre (3,), size [length] and axes (2, 3) of a flat frame, whichever way its cells turn.

    The first axis runs along the outline's first edge, the second to the cell behind it.
    """
    centre = frame.x.mean(axis=0)
    d = frame.x - centre
    _, s, axes = np.linalg.svd(d, full_matrices=False)
    size = s[0] / np.sqrt(len(d))
    height = np.abs(d @ axes[2]).max() / size
    noise = 1e2 * np.finfo(float).eps * np.abs(frame.x).max() / size
    if height > 1e-9 + noise:
        raise ContactError(
            f"design by positions needs a flat frame; nodes stand up to {height:.1e} of its size "
            "off a plane. Use design='weights'"
        )
    edges, cell = _outline(frame.cells)
    flat = d @ axes[:2].T
    t = flat[edges[0, 1]] - flat[edges[0, 0]]
    t /= np.linalg.norm(t)
    n = np.array([-t[1], t[0]])
    n *= np.sign(n @ (flat[frame.cells[cell[0]]].mean(axis=0) - flat[edges[0, 0]]))
    return centre, size, np.array([t, n]) @ axes[:2]


def _images(
    Y: np.ndarray, cells: np.ndarray, points: np.ndarray, forces: np.ndarray, M: np.ndarray
) -> list[np.ndarray] | None:
    """Image of each node (m,) and point (P,) under a mirror M, or None if the scene has it not."""
    found = []
    for x in (Y, points):
        distance, image = cKDTree(x).query(x @ M)
        if distance.max() > _SAME or len(np.unique(image)) < len(x):
            return None
        found.append(image)
    mapped = np.sort(found[0][cells], axis=1)
    same = {tuple(c) for c in mapped.tolist()} == {tuple(c) for c in np.sort(cells, 1).tolist()}
    return found if same and np.abs(forces[found[1]] - forces).max() < _SAME else None


def _symmetry(
    Y: np.ndarray, cells: np.ndarray, points: np.ndarray, forces: np.ndarray
) -> tuple[np.ndarray, _Group]:
    """Two perpendicular mirror lines through the centre, else one, else none.

    Args:
        Y: (m, 2) nodes, centre at the origin.
        points: (P, 2) positions of both sides' points without repetition.
        forces: (P, 2) force of either side at each.

    Returns:
        Axes (2, 2), rows along and across the first line, and a list of (signs (2,), images of
        nodes, images of points) in these axes, the identity first.
    """
    radius = np.linalg.norm(Y, axis=1)
    far = int(np.argmax(radius > radius.max() - _SAME))
    phi = np.arctan2(Y[:, 1], Y[:, 0])
    angles = 0.5 * (phi[far] + phi[radius > radius.max() - _SAME])
    angles = np.concatenate([angles, angles + np.pi / 2])
    angles = (angles + np.pi / 2 - 1e-6) % np.pi - np.pi / 2 + 1e-6  # in (-pi/2, pi/2]
    axes = np.eye(2)
    best: _Group = []
    for a in angles[np.argsort(np.round(np.abs(angles), 7), kind="stable")]:
        R = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
        signs = np.array([[1, -1], [-1, 1]])
        found = [(g, _images(Y, cells, points, forces, R.T @ np.diag(g) @ R)) for g in signs]
        images = [(g, *f) for g, f in found if f is not None]
        if len(images) > len(best):
            axes, best = R, images
        if len(best) == 2:
            (_, n0, p0), (_, n1, p1) = best
            best = [*best, (np.array([-1, -1]), n0[n1], p0[p1])]
            break
    return axes, [(np.array([1, 1]), np.arange(len(Y)), np.arange(len(points))), *best]


def _parameters(Y: np.ndarray, cells: np.ndarray, group: _Group) -> np.ndarray:
    """(2 m, n_q) map of free parameters to displacements, in units of the sides at each node.

    Outline corners stay, outline nodes slide on their straight line, images move alike.
    """
    edges, _ = _outline(cells)
    ends = np.concatenate([edges, edges[:, ::-1]])
    sides = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2)
    length = np.tile(np.linalg.norm(Y[sides[:, 1]] - Y[sides[:, 0]], axis=1), 2)
    h = np.bincount(sides.T.ravel(), length) / np.bincount(sides.ravel())
    columns = []
    for J in np.unique(np.min([nodes for _, nodes, _ in group], axis=0)):
        free = np.eye(2)
        t = Y[ends[ends[:, 0] == J, 1]] - Y[J]
        if len(t):
            t /= np.linalg.norm(t, axis=1, keepdims=True)
            t *= np.sign(t[:, np.abs(t[0]).argmax()])[:, None]
            free = t[:1] if np.abs(t - t[0]).max() < 1e-8 else free[:0]
        kept = np.mean([g for g, nodes, _ in group if nodes[J] == J], axis=0)
        for d in free[(np.abs(free * (kept - 1.0)) < 1e-8).all(axis=1)]:
            column = np.zeros_like(Y)
            for g, nodes, _ in group:
                column[nodes[J]] = h[J] * g * d
            columns.append(column.ravel())
    return np.array(columns).reshape(-1, Y.size).T


def _scenes(
    frame: Frame, x: Sequence[np.ndarray], forces: Sequence[np.ndarray], bounds: np.ndarray
) -> tuple[_Scene, _Scene, np.ndarray, np.ndarray]:
    """Search scene (rounded, reduced by symmetry), exact scene, Z without symmetry and the lift.

    Nothing in them depends on the order of the sides or points or on the cells' orientation.
    """
    centre, size, axes = _plane(frame)
    Y, s = (frame.x - centre) @ axes.T / size, (np.concatenate(x) - centre) @ axes.T / size
    both = np.concatenate(forces) / max(np.max(f) for f in forces)
    side = np.repeat([0, 1], [len(f) for f in forces])
    _, first, inverse = np.unique(
        np.round(s / 1e-8), axis=0, return_index=True, return_inverse=True
    )
    F = np.zeros((len(first), 2))
    np.add.at(F, (inverse.ravel(), side), both)
    R, group = _symmetry(Y, frame.cells, s[first], F)
    Y, s, axes = Y @ R.T, s[first] @ R.T, R @ axes

    cells = frame.cells
    turned = vector_areas(Y, cells)[:, 2] < 0.0
    cells = np.where(turned[:, None], cells[:, ::-1], cells)
    start = cells.argmin(axis=1)[:, None] + np.arange(cells.shape[1])
    cells = np.take_along_axis(cells, start % cells.shape[1], axis=1)
    Z = _parameters(Y, cells, group)
    corners = np.stack([cells, np.roll(cells, -1, axis=1), np.roll(cells, 1, axis=1)], axis=-1)
    amin, amax, lmin = bounds
    c = np.stack([F[:, 0] - F[:, 1], F.sum(axis=1)])
    scaled = np.array([amin + _MARGIN, amax - _MARGIN, lmin / size * (1.0 + _MARGIN), 0.0])
    exact = _Scene(Y, Z, cells, np.arange(len(Y)), s, c, corners.reshape(-1, 3), scaled)
    search = _reduce(exact, group)
    return search, exact, _parameters(Y, cells, group[:1]), size * axes


def _reduce(scene: _Scene, group: _Group) -> _Scene:
    """One representative of mirrored points and cells, in canonical order and rounded."""
    mirrored = np.min([g for g, _, _ in group], axis=0) < 0
    rounded = [np.round(a / _GRID) * _GRID + 0.0 for a in (scene.Y, scene.x, scene.c)]
    Y, x, c = rounded
    here = np.flatnonzero(np.all((x >= -_SAME) | ~mirrored, axis=1))
    here = here[np.lexsort(np.round(x[here].T / 1e-7))]
    orbits = np.array([len({int(p[i]) for _, _, p in group}) for i in here])
    c = c[:, here] * orbits
    c[0] *= np.sign(c[0, np.argmax(np.abs(c[0]) > 1e-6)])
    near = np.any(np.all((Y[scene.cells] >= -_SAME) | ~mirrored, axis=2), axis=1)
    near_corners = scene.corners.reshape(*scene.cells.shape, 3)[near].reshape(-1, 3)
    orbit = np.unique(np.min([n for _, n, _ in group], axis=0), return_inverse=True)[1].ravel()
    bounds = scene.bounds.copy()
    bounds[3] = _SUPPORT * c[1].sum() / len(Y)
    Z = np.round(scene.Z / _GRID) * _GRID
    return _Scene(Y, Z, scene.cells[near], orbit, x[here], c, near_corners, bounds)


def _polish(
    scene: _Scene, Y: np.ndarray, Z: np.ndarray, steps: int = 8
) -> tuple[np.ndarray, float]:
    """Least-norm Newton steps on (28) with the exact positions: best nodes and their residual."""
    best, least = Y, np.inf
    for _ in range(steps):
        f, df = _forces(scene, Y[None])
        r = f[0, 0]
        if np.abs(r).max() < least:
            best, least = Y, np.abs(r).max()
        if least < 1e-16:
            break
        Y = Y - (Z @ np.linalg.lstsq(df[0, 0] @ Z, r, rcond=1e-10)[0]).reshape(-1, 2)
        if np.abs(Y - best).max() > 1e-3 or not (_shape(scene, Y[None])[0] > 0.02).all():
            break
    return best, least


def _certify(
    frame: Frame,
    x: Sequence[np.ndarray],
    forces: Sequence[np.ndarray],
    bounds: np.ndarray,
    tol: float,
) -> float | None:
    """Singular value ratio of L_b, or None where a constraint or the patch test fails."""
    amin, amax, lmin = bounds
    location = [frame.locate(p) for p in x]
    L = [frame.interpolation(loc) for loc in location]
    r = np.abs(L[0].T @ forces[0] - L[1].T @ forces[1]).max() / max(np.max(f) for f in forces)
    quality = frame.quality
    angles = np.radians([quality.min_angle, quality.max_angle])
    covered = max(loc.outside.max() for loc in location) < 1e-8
    shaped = angles[0] >= amin and angles[1] <= amax and quality.min_side >= lmin
    if r > tol or not covered or not shaped:
        return None
    sv = np.linalg.svd(np.concatenate([a.toarray() for a in L]), compute_uv=False)
    return sv[-1] / sv[0] if len(sv) == len(frame.x) and sv[-1] >= _RANK * sv[0] else None


def design_positions(
    frame: Frame,
    x: Sequence[np.ndarray],
    forces: Sequence[np.ndarray],
    *,
    min_angle: float = 25.0,
    max_angle: float = 155.0,
    min_side: float | None = None,
    tol: float = 1e-13,
    seed: int = 2001,
    starts: int | None = None,
) -> Frame:
    """Move the nodes of a flat frame within its plane until it passes the patch test (28).

    Rebel, Park and Felippa (2001), section 5: minimises (29) under symmetry (of scenes with mirror
    lines), fixed outline corners, straight outlines, corner angles and side lengths within bounds;
    beyond the paper, L_b keeps full column rank. Of the passing frames in the first batch of
    starts that has any, the one with the largest singular value ratio of L_b. Deterministic, and
    independent of the order of the sides, units and position in space (up to rounding).

    Args:
        frame: flat prediction in 3D that covers all points, m nodes [length].
        x: pair of (n_i, 3) positions of the two sides' nodes [length].
        forces: pair of (n_i,) energy-equivalent forces of unit pressure [area].
        min_angle: least corner angle [degree].
        max_angle: largest corner angle [degree].
        min_side: shortest side [length]; default 0.3 of the prediction's shortest.
        tol: largest residual over the largest force. Where the coordinates' rounding is larger
            (a scene far from the origin), 20 eps max|x| / size holds instead.
        seed: of the random starts.
        starts: how many are tried at most; default 16 to 2000, by the number of free parameters.

    Returns:
        The designed frame, same cells.

    Raises:
        ContactInputError: an argument of another type, shape or size.
        ContactError: the frame is not flat, does not cover the points, or no start passes.
    """
    angles, sizes, search_for = (min_angle, max_angle), (min_side, tol), (seed, starts)
    x, forces = position_arguments(frame, x, forces, angles, sizes, search_for)
    lmin = 0.3 * frame.quality.min_side if min_side is None else min_side
    bounds = np.array([np.radians(min_angle), np.radians(max_angle), lmin])
    search, exact, free, lift = _scenes(frame, x, forces, bounds)
    outside = max(frame.locate(p).outside.max() for p in x)
    if outside > 1e-8:
        raise ContactError(
            f"design by positions: contact points stand up to {outside:.1e} of a cell outside the "
            "frame, whose outline is kept. Predict a frame that covers all points"
        )
    n_q = search.Z.shape[1]
    starts = int(np.clip(28000 // max(n_q, 1), 16, 2000)) if starts is None else starts
    work = search.corners.size * n_q + len(search.x) * len(search.cells) * 8
    batch = int(np.clip(4_000_000 // max(work, 1), 1, 400))
    far = max(np.abs(a).max() for a in (frame.x, *x)) / np.linalg.norm(lift[0])
    tol = max(tol, 20.0 * np.finfo(float).eps * far)

    # A prediction that passes, or all but passes (printed digits), needs no search.
    near = _finish(frame, exact, free, lift, np.zeros(n_q), tol)
    if near is not None and _certify(near, x, forces, bounds, tol) is not None:
        return near
    rng, reached = np.random.default_rng(seed), np.inf
    batches = range(0, starts if n_q else 0, batch)
    for done in progress(batches, "frame design"):
        q = _starts(search, min(batch, starts - done), rng)
        q[0] *= float(done > 0)
        q, rows = _descend(search, q)
        reached = min(reached, rows.min())
        found = []
        for candidate in q[rows < 1e-7]:
            moved = _finish(frame, exact, free, lift, candidate, tol)
            ratio = None if moved is None else _certify(moved, x, forces, bounds, tol)
            if moved is not None and ratio is not None:
                found.append((-round(ratio, 4), float(np.abs(moved.x - frame.x).max()), moved))
        if found:
            return min(found, key=lambda f: f[:2])[2]
    raise ContactError(
        f"design by positions: none of {starts} starts with {n_q} free parameters passes within "
        f"the bounds (angles {min_angle:g} to {max_angle:g} degrees, sides from {lmin:.3g}, "
        f"sigma_min/sigma_max of L_b from {_RANK:g}, residual up to {tol:.1e}); the closest left "
        f"{reached:.1e} of residual or violation. Use design='weights', more starts, wider bounds "
        "or another prediction"
    )


def _finish(
    frame: Frame, exact: _Scene, free: np.ndarray, lift: np.ndarray, q: np.ndarray, tol: float
) -> Frame | None:
    """Frame of search parameters q, polished with the exact positions; None if it degenerates."""
    Y, least = _polish(exact, exact.nodes(q[None])[0], exact.Z)
    if least > 0.5 * tol:
        Y, _ = _polish(exact, Y, free)
    try:
        return Frame(frame.x + (Y - exact.Y) @ lift, frame.cells)
    except ContactError:
        return None
