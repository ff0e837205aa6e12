"""What the designs of frames are given: checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix, issparse

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.frame import Frame


def check_frame(frame: Any, gdim: int | None = None) -> None:
    """Require a frame.

    Args:
        frame: what was given.
        gdim: its dimension; None: any.

    Raises:
        ContactInputError: something else.
    """
    checks.instance("frame", frame, Frame, "give a dolfinx_llm.Frame")
    if gdim is not None and frame.gdim != gdim:
        raise ContactInputError(f"frame: lies in {frame.gdim}D, give one in {gdim}D")


def pair(name: str, value: Any) -> list[Any]:
    """The two items of an argument with one for each side.

    Args:
        name: of the argument.
        value: what was given.

    Raises:
        ContactInputError: it has not two.
    """
    accepted = "give a pair, one item for each side"
    found = checks.items(name, value, accepted)
    if len(found) != 2:
        checks.refuse(name, value, accepted)
    return found


def forces_of(forces: Any, counts: Sequence[int]) -> list[Array]:
    """Forces of unit pressure of both sides.

    Args:
        forces: what was given.
        counts: nodes of each side.

    Raises:
        ContactInputError: other shapes, negative or no forces.
    """
    accepted = "give a pair of (n_i,) forces of unit pressure, as many as nodes and none negative"
    found = [
        checks.array("forces", f, (n,), accepted)
        for f, n in zip(pair("forces", forces), counts, strict=True)
    ]
    if any((f < 0.0).any() or not f.any() for f in found):
        checks.refuse("forces", forces, f"{accepted}, nor all zero")
    return found


def position_arguments(
    frame: Any, x: Any, forces: Any, angles: tuple[Any, Any], sizes: tuple[Any, Any], search: Any
) -> tuple[list[Array], list[Array]]:
    """Check the arguments of ``design_positions``.

    Args:
        frame, x, forces: as given.
        angles: smallest and largest.
        sizes: shortest side and tolerance.
        search: seed and number of starts.

    Returns:
        Positions and forces as arrays.

    Raises:
        ContactInputError: one of them does not fit.
    """
    check_frame(frame, 3)
    accepted = "give a pair of (n_i, 3) positions, n_i > 0"
    points = [checks.array("x", p, (None, 3), accepted) for p in pair("x", x)]
    if not all(map(len, points)):
        checks.refuse("x", x, accepted)
    degrees = "give degrees, 0 < min_angle < max_angle < 180"
    low, high = (checks.number(k, v, degrees) for k, v in zip(("min_angle", "max_angle"), angles))
    if not 0.0 < low < high < 180.0:
        raise ContactInputError(f"min_angle={low:g}, max_angle={high:g}: {degrees}")
    if sizes[0] is not None:
        checks.number("min_side", sizes[0], "give a positive length or None", above=0.0)
    checks.number("tol", sizes[1], "give a positive number", above=0.0)
    checks.integer("seed", search[0], "give an integer of at least 0", low=0)
    if search[1] is not None:
        checks.integer("starts", search[1], "give an integer of at least 1, or None", low=1)
    return points, forces_of(forces, [len(p) for p in points])


def weight_arguments(
    frame: Any, s: Any, N: Any, cells: Any, forces: Any, keep: Any
) -> tuple[Array, list[csr_matrix], list[Array], list[Array], Any]:
    """Check the arguments of ``design_weights``.

    Args:
        frame, s, N, cells, forces, keep: as given.

    Returns:
        All but the frame, as arrays.

    Raises:
        ContactInputError: one of them does not fit.
    """
    check_frame(frame)
    m = len(frame.x)
    where = f"give ({m}, {frame.gdim - 1}) coordinates of the frame's nodes in its plane"
    s = checks.array("s", s, (m, frame.gdim - 1), where)
    accepted = f"give a pair of sparse (n_i, {m}) interpolation matrices (frame.interpolation)"
    rows = pair("N", N)
    for M in rows:
        if not issparse(M) or M.shape[1] != m or not np.isfinite(M.data).all():
            checks.refuse("N", M, accepted)
    counts = [M.shape[0] for M in rows]
    words = f"give a pair of (n_i,) frame cells, 0 to {len(frame.cells) - 1}, one for each row of N"
    at = [
        checks.array("cells", c, (n,), words, integers=True)
        for c, n in zip(pair("cells", cells), counts, strict=True)
    ]
    if any(len(c) and not 0 <= c.min() <= c.max() < len(frame.cells) for c in at):
        checks.refuse("cells", cells, words)
    if keep is not None:
        flags = "give a pair of (n_i,) booleans, one for each row of N, or None"
        keep = [np.asarray(k) for k in pair("keep", keep)]
        for k, n in zip(keep, counts, strict=True):
            if k.shape != (n,) or k.dtype != bool:
                checks.refuse("keep", k, flags)
    return s, [M.tocsr() for M in rows], at, forces_of(forces, counts), keep
