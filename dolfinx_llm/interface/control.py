"""Interfaces of second-order bodies that may part, in control values: see ``operators.control``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.pairs import ContactPairs, control_matrices, nodal_rows
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.geometry import InterfaceGeometry


def frame_control(frame: Frame) -> csr_matrix:
    """(m, m) values at a frame's nodes from its control values."""
    return nodal_rows(frame.cells, frame.element.bernstein, len(frame.x))


def in_control_values(pairs: ContactPairs, frame: Frame | None) -> ContactPairs:
    """Pairs whose rows, gaps and forces are those of control values of side and frame; against an
    obstacle of the side alone."""
    N = pairs.N
    if frame is not None and frame.element.order > 1:
        N = (N @ frame_control(frame)).tocsr()
    if pairs.surface.element.order == 1:
        return replace(pairs, N=N)
    E, C = (M[pairs.nodes][:, pairs.nodes].tocsr() for M in control_matrices(pairs.surface))
    loads = replace(pairs.loads, forces=E.T @ pairs.loads.forces)
    gap = C @ pairs.gap
    if frame is None:  # distances, each along a normal of its own
        across = C @ np.einsum("ni,ni->n", pairs.gap, pairs.normal)
        gap = across[:, None] * pairs.normal
    return replace(pairs, N=(C @ N).tocsr(), gap=gap, loads=loads, control=E)


def control_values(pairs: ContactPairs, values: np.ndarray) -> np.ndarray:
    """(n, ...) control values from values at the nodes of pairs."""
    if pairs.control is None:
        return values
    return np.asarray(splu(pairs.control.tocsc()).solve(values))


def controlled(geometries: Sequence[InterfaceGeometry]) -> list[tuple[int, Surface]]:
    """(space, surface) of the tagged second-order surfaces that may part.

    Raises:
        ContactInputError: such a surface shares an edge with one that is tied.
    """
    found: list[tuple[int, Surface]] = []
    tied: list[tuple[int, Surface]] = []
    for geometry in geometries:
        for space, surface in zip(geometry.spaces, geometry.site.whole, strict=True):
            if surface.element.order > 1:
                (tied if geometry.interface.law.ties else found).append((space, surface))
    for space, surface in tied:
        for other, free in found:
            middles = free.dofs[free.cells[:, free.facets.shape[1] :]]
            if space == other and np.isin(surface.dofs, middles).any():
                raise ContactInputError(
                    f"{surface.name} is tied and shares an edge with {free.name}, which may part: "
                    "of second-order bodies both must be of one kind. Leave a facet between them, "
                    "or use first-order bodies"
                )
    return found


def at_nodes(pairs: ContactPairs, force: np.ndarray) -> np.ndarray:
    """(n, ...) forces at the nodes of pairs that do the same work as these of theirs."""
    if pairs.control is None:
        return force
    return np.asarray(splu(pairs.control.T.tocsc()).solve(force))


def nodal_values(geometry: InterfaceGeometry, v: np.ndarray) -> np.ndarray:
    """(m, gdim) values at the frame's nodes from the frame unknowns' (m, gdim)."""
    frame = geometry.frame
    if frame is None or frame.element.order == 1 or geometry.interface.law.ties:
        return v
    return np.asarray(frame_control(frame) @ v)
