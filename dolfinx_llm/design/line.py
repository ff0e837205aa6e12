"""Frame of a straight contact line in closed form: its nodes are zeros of a moment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.design.line_nodes import choose_nodes, moment_roots, nearest_nodes
from dolfinx_llm.design.weights import TOLERANCE
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.overlap_flat import Plane, covered_forces
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.geometry.surface import Surface

_EPS = np.finfo(float).eps


def frame_at_roots(
    sides: Sequence[Surface], plane: Plane, area: Any, frame: Frame | None = None
) -> tuple[Frame, str]:
    """Frame of a straight interface that passes the patch test (28), in closed form.

    Args:
        sides: the two surfaces, in 2D.
        plane: contact line.
        area: (2,) interval in contact, in its coordinate [length].
        frame: nodes to start from, which go to the nearest roots; None: as dense as the locally
            coarser side, halfway between the sides.

    Returns:
        The frame, its normal out of side 0, and a sentence that says what it is.

    Raises:
        ContactError: a side touches in several pieces, or more frame nodes than roots.
    """
    # The same way along the line whichever side comes first: equally good choices stay the same.
    t = plane.base[0]
    way = 1.0 if t[np.abs(t).argmax()] > 0.0 else -1.0
    x0, x1 = (way * _loaded_nodes(side, plane, area)[:: int(way)] for side in sides)
    interval = np.sort(way * np.asarray(area))
    size = max(np.abs(side.x).max() for side in sides)
    roots = moment_roots(x0, x1, interval, size)
    if frame is None:
        s = choose_nodes(roots, x0, x1)
        height = np.mean([plane.height(side.x).mean() for side in sides])
        x = plane.lift(way * s[:, None]) + height * plane.normal
        new = Frame(x, np.column_stack([np.arange(len(s) - 1), np.arange(1, len(s))]))
        start = "closed form"
    else:
        given = way * plane.project(frame.x)[:, 0]
        order = np.argsort(given, kind="stable")
        place = np.argsort(order)
        if (
            len(frame.cells) != len(given) - 1
            or not (np.ptp(place[frame.cells], axis=1) == 1).all()
        ):
            raise ContactError(
                f"the frame's {len(frame.cells)} cells are no chain along its {len(given)} nodes: "
                "in closed form it must be one line without gaps or folds"
            )
        s = np.empty(len(given))
        s[order] = nearest_nodes(given[order], roots)
        new = Frame(frame.x + np.outer(way * (s - given), t), frame.cells)
        start = "given, moved"
    if _turned(new, plane):
        new = new.flipped()
    return new, f"frame: {start}, {len(s)} of {len(roots.points)} zeros of the moment of the forces"


def check_closed_form(residual: float, pairs: Sequence[ContactPairs], frame: Frame) -> None:
    """Require that a frame passes (28) as far as the rounding of its coordinates allows.

    Raises:
        ContactError: it does not; both sides do not carry the same force there.
    """
    size = max(np.abs(p.x).max() for p in pairs)
    bound = max(TOLERANCE, 16.0 * _EPS * size / frame.cell_size.min())
    if not residual <= bound:
        raise ContactError(
            f"the closed form leaves a patch residual of {residual:.1e} of the largest nodal force "
            f"(allowed {bound:.1e}): the surfaces are no straight lines that both cover the "
            'contact area without gaps. Mend the tags, or use design="weights"'
        )


def _turned(frame: Frame, plane: Plane) -> bool:
    edge = frame.x[frame.cells[:, 1]] - frame.x[frame.cells[:, 0]]
    return bool(np.array([-edge[:, 1].sum(), edge[:, 0].sum()]) @ plane.normal < 0.0)


def _loaded_nodes(side: Surface, plane: Plane, area: Any) -> Array:
    """(n,) ascending coordinates of a side's nodes whose facets carry force."""
    s = plane.project(side.x)
    facets = side.facets[covered_forces(s, side.facets, area).sum(axis=1) > 0.0]
    nodes = np.unique(facets)
    x = np.sort(s[nodes, 0])
    if len(nodes) != len(facets) + 1 or not (np.diff(x) > 0.0).all():
        raise ContactError(
            f"the {len(facets)} facets of {side.name} in contact have {len(nodes)} nodes: they are "
            "in several pieces, or fold over. Give each piece a tag and an interface of its own"
        )
    return x
