"""Prediction of a frame from the two surfaces, and its orientation.

The facets in contact of the coarser side: the frame's nodes are then nodes of that side, so that
L_b has full column rank whatever the other side looks like, and it is as dense as the coarser side.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.cells import bases, vector_areas
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.overlap_flat import Plane
from dolfinx_llm.geometry.surface import Surface


def predict_frame(
    sides: Sequence[Surface],
    forces: Sequence[np.ndarray],
    plane: Plane | None = None,
    by_nodes: bool = False,
) -> tuple[Frame, str]:
    """Frame for two surfaces: the facets in contact of the coarser side.

    Args:
        sides: the two surfaces.
        forces: pair of (n_i,) forces of unit pressure; 0 at nodes that are not in contact.
        plane: contact plane of flat surfaces, halfway between which the frame lies; None: the
            facets stay where they are.
        by_nodes: of ``coarser_facets``.

    Returns:
        The frame and a sentence that says what it is.
    """
    k, facets = coarser_facets(sides, forces, by_nodes)
    nodes, cells = np.unique(facets, return_inverse=True)
    cells = cells.reshape(facets.shape)
    x = sides[k].x[nodes]
    if plane is not None:
        middle = np.mean([plane.height(side.x).mean() for side in sides])
        x = x + np.outer(middle - plane.height(x), plane.normal)
    note = f"frame: predicted, the {len(facets)} facets in contact of the coarser side "
    return Frame(x, cells if k == 0 else cells[:, ::-1]), f"{note}({sides[k].name})"


def coarser_facets(
    sides: Sequence[Surface], forces: Sequence[np.ndarray], by_nodes: bool = False
) -> tuple[int, np.ndarray]:
    """Which side is coarser, 0 or 1, and its facets (m, k) whose nodes all carry force.

    By the size of the facets; or by the number of nodes: where contact may open no side may have
    fewer nodes than the frame, or pressures arise that it does not feel.
    """
    touched = []
    for side, f in zip(sides, forces):
        # A facet counts if all its nodes carry force: those that the area merely borders do not.
        facets = side.facets[(f[side.facets] > 0.0).all(axis=1)]
        size = np.linalg.norm(vector_areas(side.x, facets), axis=1).mean()
        touched.append((facets, size))
    counts = [len(np.unique(facets)) for facets, _ in touched]
    (_, size0), (_, size1) = touched
    if by_nodes and counts[0] != counts[1]:
        k = int(np.argmin(counts))
    elif abs(size0 - size1) > 1e-9 * max(size0, size1):
        k = int(size1 > size0)
    else:
        k = _of_equal(sides, [facets for facets, _ in touched])
    return k, touched[k][0]


def _of_equal(sides: Sequence[Surface], facets: Sequence[np.ndarray]) -> int:
    """Which of two equally coarse sides, by what depends neither on their order nor on the axes."""
    if len(facets[0]) != len(facets[1]):
        return int(len(facets[1]) > len(facets[0]))
    x = [side.x[np.unique(f)] for side, f in zip(sides, facets, strict=True)]
    d = [np.linalg.norm(y - np.mean([y.mean(axis=0) for y in x], axis=0), axis=1) for y in x]
    for power in (2, 3, 4):
        moment = [float((r**power).sum()) for r in d]
        if abs(moment[0] - moment[1]) > 1e-9 * max(moment):
            return int(moment[1] > moment[0])
    keys = [tuple(side.x[f].sum(axis=(0, 1))) for side, f in zip(sides, facets, strict=True)]
    return 0 if keys[0] <= keys[1] else 1  # alike: the axes decide


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
