"""What the search for a frame sees: the frame's plane, its mirrors, what its nodes may do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.design.positions_search import Scene
from dolfinx_llm.geometry.cells import vector_areas
from dolfinx_llm.geometry.frame import Frame

_GRID = 1e-10 / np.sqrt(2.0)  # the search sees plane coordinates and forces rounded to this grid
_SAME = 1e-9  # points closer than this (frame of size 1) are images of each other
_SUPPORT = 0.02  # least force that reaches a frame node, over the mean of all nodes
_MARGIN = 1e-3  # [rad, relative] by which the search stays inside angle and side bounds

# Mirrors of a scene: signs (2,) of the axes, images of the nodes (m,) and of the points (P,).
Group = list[tuple[Array, Array, Array]]


def _outline(cells: Array) -> tuple[Array, Array]:
    """Edges (n, 2) that belong to one cell, lower node first and sorted; and their cells (n,)."""
    edges = np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, first, count = np.unique(edges, axis=0, return_index=True, return_counts=True)
    return edges[count == 1], first[count == 1] // cells.shape[1]


def _plane(frame: Frame) -> tuple[Array, float, Array]:
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


def _images(Y: Array, cells: Array, points: Array, forces: Array, M: Array) -> list[Array] | None:
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


def _symmetry(Y: Array, cells: Array, points: Array, forces: Array) -> tuple[Array, Group]:
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
    best: Group = []
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


def _parameters(Y: Array, cells: Array, group: Group) -> Array:
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


def search_scenes(
    frame: Frame, x: Sequence[Array], forces: Sequence[Array], bounds: Array
) -> tuple[Scene, Scene, Array, Array]:
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
    exact = Scene(Y, Z, cells, np.arange(len(Y)), s, c, corners.reshape(-1, 3), scaled)
    search = _reduce(exact, group)
    return search, exact, _parameters(Y, cells, group[:1]), size * axes


def _reduce(scene: Scene, group: Group) -> Scene:
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
    return Scene(Y, Z, scene.cells[near], orbit, x[here], c, near_corners, bounds)
