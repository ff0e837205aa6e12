"""Surfaces that are tied, of which one carries the frame: its nodes are its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix, identity

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.design.balance import balance
from dolfinx_llm.design.bent import bent_normals, bent_rows
from dolfinx_llm.design.curved import smooth_rows
from dolfinx_llm.design.residual import FrameLoads
from dolfinx_llm.design.weights import balanced_rows
from dolfinx_llm.geometry.frame import Frame, bent
from dolfinx_llm.geometry.loads import NodalLoads, loads_in_contact
from dolfinx_llm.geometry.overlap_flat import Plane, common_area
from dolfinx_llm.geometry.pairs import ContactPairs, locate_pairs
from dolfinx_llm.geometry.pieces import tied_plane
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.frames import REACH

LIES_ON_OUTLINE = 0.02  # cells off the outline, whose edges cut arcs, up to which nodes lie on it


def carried_rows(moving: Surface, carrier: Surface) -> tuple[Array, csr_matrix, float]:
    """Nodes (p,) of a surface that are tied to another one, their rows (p, m) of its nodes, and the
    largest correction. Tractions pass that are linear along flat surfaces, nearly so along curved
    ones.

    Raises:
        ContactError: the surfaces do not face each other, or rows cannot be corrected.
    """
    sides = moving, carrier
    frame, plane = Frame(carrier.straightened(carrier.x), carrier.cells), tied_plane(sides)
    if plane is None:
        loads, _ = loads_in_contact(sides, False, 2)
        frame = bent(frame, carrier.x)
    else:
        area = common_area(*sides, plane)
        loads = [NodalLoads.over(side, plane, area, 2) for side in sides]
    own, other = _on_own_nodes(sides, loads, frame, plane)
    keep = np.zeros(len(own.nodes), dtype=bool), np.ones(len(other.nodes), dtype=bool)
    if plane is None:
        N = bent_rows(frame, (own, other), bent_normals(frame), keep)
    else:
        s, plain = plane.project(frame.x), (own.N, other.N)
        loading = FrameLoads.of(frame, s, plain, (own.loads, other.loads))
        N = [*balanced_rows(frame, loading, plain, keep)[0]]
    return own.nodes, N[0], float(abs(N[0] - own.N).max())


def round_rows(
    moving: Surface, carrier: Surface, close_gap: bool
) -> tuple[Array, csr_matrix, float]:
    """The same of first-order surfaces along a curved one, which facets cut: rows reproduce the
    nodes' places, or those below them on the smooth surface where gaps are to be closed.

    Raises:
        ContactError: the surfaces do not face each other.
    """
    sides, frame = (moving, carrier), Frame(carrier.x, carrier.facets)
    loads, vectors = loads_in_contact(sides, False, 1)
    own, other = pairs = _on_own_nodes(sides, loads, frame, None)
    smooth = smooth_rows(frame, pairs, close_gap, near=LIES_ON_OUTLINE)
    areas = [a[p.nodes] for a, p in zip(vectors, pairs, strict=True)]
    start = smooth.rows(1.0)[0], other.N
    found = balance(start, areas, smooth.stencils, stay=(False, True))[0]
    return own.nodes, found, float(abs(found - own.N).max())


def _on_own_nodes(
    sides: Sequence[Surface], loads: Sequence[NodalLoads], frame: Frame, plane: Plane | None
) -> tuple[ContactPairs, ContactPairs]:
    """Pairs of both sides on a frame of the second one's nodes, whose rows are the identity."""
    own, other = locate_pairs(sides, loads, frame, REACH, plane)
    return own, replace(other, N=identity(len(frame.x), format="csr")[other.nodes])
