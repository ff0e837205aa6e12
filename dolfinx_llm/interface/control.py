"""Interfaces of second-order bodies that may part, in control values: see ``operators.control``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.cells import connected, unit
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.pairs import ContactPairs, control_matrices, nodal_rows
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.geometry import InterfaceGeometry

UNPRESSED = 1e-9  # part of the largest area, whose direction is rounding


def frame_control(frame: Frame) -> csr_matrix:
    """(m, m) values at a frame's nodes from its control values."""
    return nodal_rows(frame.cells, frame.element.bernstein, len(frame.x))


def in_control_values(pairs: ContactPairs, frame: Frame | None, held: bool) -> ContactPairs:
    """Pairs whose rows, gaps and forces are those of control values of side and frame; against an
    obstacle of the side alone.

    Args:
        pairs: of one side.
        frame: None: there is an obstacle in its place.
        held: nothing that contact does moves it: an obstacle, or a frame that supports hold.
            Forces need not balance there, and pairs have normals of their own.
    """
    if frame is not None and frame.element.order > 1:
        pairs = replace(pairs, N=(pairs.N @ frame_control(frame)).tocsr())
    own = _own_control(pairs, frame)
    return _with_own_normals(own) if held else own


def _own_control(pairs: ContactPairs, frame: Frame | None) -> ContactPairs:
    """The same of the side alone."""
    if pairs.surface.element.order == 1:
        return pairs
    E, C = (M[pairs.nodes][:, pairs.nodes].tocsr() for M in control_matrices(pairs.surface))
    if frame is not None and len(np.unique(pairs.nodes)) < len(pairs.nodes):
        # Nodes with a pair in each of several parts: of one part all.
        part = connected(frame.cells, len(frame.x))[0][pairs.cell]
        E, C = (_within(M, part) for M in (E, C))
    loads = replace(pairs.loads, forces=E.T @ pairs.loads.forces)
    return replace(pairs, N=(C @ pairs.N).tocsr(), gap=C @ pairs.gap, loads=loads, control=E)


def _within(M: csr_matrix, part: Array) -> csr_matrix:
    """(n, n) entries of a matrix between rows of the same part (n,)."""
    M = M.tocoo()
    own = part[M.row] == part[M.col]
    return csr_matrix((M.data[own], (M.row[own], M.col[own])), shape=M.shape)


def _with_own_normals(pairs: ContactPairs) -> ContactPairs:
    """The same, with normals along what a constant pressure exerts at control values: along those
    at the nodes it would not pass where a facet turns, by an error of first order."""
    if pairs.control is None:
        return pairs
    assert pairs.loads.mass is not None
    exerted = pairs.control.T @ (pairs.loads.mass @ pairs.normal)
    pressed = np.einsum("ni,ni->n", exerted, pairs.normal)
    told = (pressed > UNPRESSED * pressed.max(initial=0.0))[:, None]
    return replace(pairs, normal=unit(np.where(told, exerted, pairs.normal)))


def with_control(geometries: Sequence[InterfaceGeometry]) -> list[InterfaceGeometry]:
    """The same; ties that share an edge with surfaces that may part are in control values, too."""
    out = list(geometries)
    rest = {i for i, geometry in enumerate(out) if geometry.interface.law.ties}
    found = controlled([geometry for i, geometry in enumerate(out) if i not in rest])
    while taken := {i for i in rest if _meets(out[i], found)}:
        for i in taken:  # their frames stay as they are
            own = tuple(_own_control(pairs, out[i].frame) for pairs in out[i].pairs)
            out[i] = replace(out[i], pairs=own)
        rest -= taken
        found = controlled([geometry for i, geometry in enumerate(out) if i not in rest])
    return out


def control_values(pairs: ContactPairs, values: Array) -> Array:
    """(n, ...) control values from values at the nodes of pairs."""
    if pairs.control is None:
        return values
    return np.asarray(splu(pairs.control.tocsc()).solve(values))


def controlled(geometries: Sequence[InterfaceGeometry]) -> list[tuple[int, Surface]]:
    """(space, surface) of the tagged surfaces in control values."""
    return [
        (space, surface)
        for geometry in geometries
        for p, space, surface in zip(geometry.pairs, geometry.spaces, geometry.site.whole)
        if p.control is not None
    ]


def _meets(geometry: InterfaceGeometry, found: Sequence[tuple[int, Surface]]) -> bool:
    """Whether one of an interface's surfaces shares nodes with these."""
    return any(
        space == other and np.isin(surface.dofs, there.dofs).any()
        for space, surface in zip(geometry.spaces, geometry.site.whole, strict=True)
        for other, there in found
    )


def at_nodes(pairs: ContactPairs, force: Array) -> Array:
    """(n, ...) forces at the nodes of pairs that do the same work as these of theirs."""
    if pairs.control is None:
        return force
    return np.asarray(splu(pairs.control.T.tocsc()).solve(force))


def of_control_values(pairs: ContactPairs, force: Array) -> Array:
    """(n, ...) forces of pairs that do the same work as these at their nodes."""
    return force if pairs.control is None else np.asarray(pairs.control.T @ force)


def nodal_values(geometry: InterfaceGeometry, v: Array) -> Array:
    """(m, gdim) values at the frame's nodes from the frame unknowns' (m, gdim)."""
    frame = geometry.frame
    if frame is None or frame.element.order == 1 or geometry.interface.law.ties:
        return v
    return np.asarray(frame_control(frame) @ v)
