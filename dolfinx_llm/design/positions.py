"""Frame design by node positions: a flat frame is moved until it passes the contact patch test.

Section 5 of Rebel, Park and Felippa (2001). The residual (28) is only C0 in the node positions (a
contact point that crosses an edge of the frame kinks it), so a single descent from a prediction
gets stuck. Here many starts descend together, in one NumPy batch, on the residual and the violated
constraints; the best shaped of the frames that pass is chosen.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.log import progress
from dolfinx_llm.design.arguments import position_arguments
from dolfinx_llm.design.positions_scene import search_scenes
from dolfinx_llm.design.positions_search import Scene, descend, polish, random_starts
from dolfinx_llm.geometry.frame import Frame

_RATIO = 0.02  # least ratio of the singular values of L_b


def design_positions(
    frame: Frame,
    x: Sequence[Array],
    forces: Sequence[Array],
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
    search, exact, free, lift = search_scenes(frame, x, forces, bounds)
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
        q = random_starts(search, min(batch, starts - done), rng)
        q[0] *= float(done > 0)
        q, rows = descend(search, q)
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
        f"sigma_min/sigma_max of L_b from {_RATIO:g}, residual up to {tol:.1e}); the closest "
        f"left {reached:.1e} of residual or violation. Use design='weights', more starts, wider "
        "bounds or another prediction"
    )


def _finish(
    frame: Frame, exact: Scene, free: Array, lift: Array, q: Array, tol: float
) -> Frame | None:
    """Frame of search parameters q, polished with the exact positions; None if it degenerates."""
    Y, least = polish(exact, exact.nodes(q[None])[0], exact.Z)
    if least > 0.5 * tol:
        Y, _ = polish(exact, Y, free)
    try:
        return Frame(frame.x + (Y - exact.Y) @ lift, frame.cells)
    except ContactError:
        return None


def _certify(
    frame: Frame,
    x: Sequence[Array],
    forces: Sequence[Array],
    bounds: Array,
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
    return sv[-1] / sv[0] if len(sv) == len(frame.x) and sv[-1] >= _RATIO * sv[0] else None
