"""Prediction of a frame from the two surfaces, and its orientation.

The facets in contact of the coarser side: the frame's nodes are then nodes of that side, so that
L_b has full column rank whatever the other side looks like, and it is as dense as the coarser side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.cells import bases, vector_areas
from dolfinx_llm.geometry.frame import Frame, bent
from dolfinx_llm.geometry.overlap_flat import Plane
from dolfinx_llm.geometry.surface import Surface


def predict_frame(
    sides: Sequence[Surface],
    touched: Sequence[Array],
    plane: Plane | None,
    by_nodes: bool,
    corners: int | None,
    order: int = 1,
    carrier: int | None = None,
) -> tuple[Frame, str]:
    """Frame for two surfaces: the facets in contact of the coarser side.

    Args:
        sides: the two surfaces.
        touched: pair of (n_i,) whether nodes belong to facets in contact.
        plane: contact plane of flat surfaces, halfway between which the frame lies; None: the
            facets stay where they are.
        by_nodes: of ``coarser_side``.
        corners: of the frame's cells where only one kind will do; None: those of the coarser side.
        order: of the cells, at most that of both sides; those of second order on curved surfaces
            are bent as drawn.
        carrier: side whose facets they are; None: the coarser one.

    Returns:
        The frame and a sentence that says what it is.
    """
    k = coarser_side(sides, touched, by_nodes) if carrier is None else carrier
    if corners not in (None, sides[k].facets.shape[1]):
        k = 1 - k
    facets = touched_facets(sides[k], touched[k])
    chosen = (sides[k].cells if order > 1 else sides[k].facets)[facets]
    nodes, cells = np.unique(chosen, return_inverse=True)
    cells = cells.reshape(chosen.shape)
    x = sides[k].straightened(sides[k].x)[nodes]
    if plane is not None:
        middle = np.mean([plane.height(side.x).mean() for side in sides])
        x = x + np.outer(middle - plane.height(x), plane.normal)
    which = "of the coarser side " if carrier is None else ""
    note = f"frame: predicted, the {len(facets)} facets in contact {which}"
    frame = Frame(x, cells)
    frame = frame if k == 0 else frame.flipped()
    if plane is None and order > 1:
        frame = bent(frame, sides[k].x[nodes])
    return frame, f"{note}({sides[k].name})"


def coarser_side(sides: Sequence[Surface], touched: Sequence[Array], by_nodes: bool) -> int:
    """Which side is coarser where they are in contact, 0 or 1.

    By the size of the facets; or by the number of nodes: where contact may open no side may have
    fewer nodes than the frame, or pressures arise that it does not feel.
    """
    own = [touched_facets(side, nodes) for side, nodes in zip(sides, touched, strict=True)]
    corners = [side.facets[facets] for side, facets in zip(sides, own, strict=True)]
    size0, size1 = (
        np.linalg.norm(vector_areas(side.x, facets), axis=1).mean()
        for side, facets in zip(sides, corners, strict=True)
    )
    counts = [len(np.unique(facets)) for facets in corners]
    if by_nodes and counts[0] != counts[1]:
        k = int(np.argmin(counts))
    elif abs(size0 - size1) > 1e-9 * max(size0, size1):
        k = int(size1 > size0)
    else:  # equally coarse: what depends neither on the order of the sides nor on the axes decides
        shapes = [_shape(side.x, facets) for side, facets in zip(sides, corners)]
        scale = np.maximum(np.abs(shapes[0]), np.abs(shapes[1]))
        apart = np.flatnonzero(np.abs(shapes[0] - shapes[1]) > 1e-9 * scale)
        k = int(shapes[0][apart[0]] > shapes[1][apart[0]]) if len(apart) else 0
    return k


def touched_facets(side: Surface, touched: Array) -> Array:
    """(m,) facets of a side whose nodes all take part (n,): those that the area merely borders do
    not count."""
    return np.flatnonzero((touched > 0)[side.cells].all(axis=1))


def _shape(x: Array, facets: Array) -> Array:
    """Numbers that tell one mesh from another, however they lie in space."""
    centre, size = x[facets].mean(axis=1), np.linalg.norm(vector_areas(x, facets), axis=1)
    away = np.linalg.norm(centre - size @ centre / size.sum(), axis=1)
    sides = np.linalg.norm(x[facets] - np.roll(x[facets], -1, axis=1), axis=2)
    return np.array([
        -len(facets), size @ size, sides.sum(), size @ away**2, size**2 @ away, size @ away**4
    ])  # fmt: skip


def face_side_1(frame: Frame, side0: Surface) -> Frame:
    """The frame with its normal out of side 0.

    Raises:
        ContactInputError: frame and body are not of the same dimension.
    """
    gdim = side0.x.shape[1]
    if frame.gdim != gdim:
        raise ContactInputError(f"the frame lies in {frame.gdim}D, the bodies in {gdim}D")
    area = vector_areas(side0.x, side0.facets)
    at = frame.locate(side0.x[side0.facets].mean(axis=1))
    normal = bases(frame.evaluate(at.cell, at.xi)[2])[:, -1]
    return frame.flipped() if np.einsum("fi,fi->", normal, area) < 0.0 else frame
