"""The contact frame: a surface mesh with its own nodes between two bodies.

Plain NumPy; knows neither dolfinx nor PETSc. Cells are segments (in the plane), triangles or
quadrilaterals (paper, (23)), of first or second order, with straight edges. The surface bases of a
cell follow its orientation: its normal points out of side 0 into side 1.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array, Given
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.geometry.cells import cell_sizes, corner_jacobians, points_of, turns
from dolfinx_llm.geometry.element import Element, element_of
from dolfinx_llm.geometry.gmsh_group import read_gmsh
from dolfinx_llm.geometry.location import ClosestPoints, Location

MIDDLE = 1e-10  # of a cell's size and of coordinates: how far nodes may lie off the middle
POSITIONS, NUMBERS = "give (m, gdim) node positions", "give (n, k) node numbers, integers"


@dataclass(frozen=True)
class Quality:
    """Shape of a frame's cells."""

    min_angle: float  # smallest corner angle [degree]
    max_angle: float  # largest corner angle [degree]
    min_side: float  # shortest side [length]
    min_jacobian: float  # smallest corner Jacobian over the cell's mean (1: parallelogram)


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame: nodes Y (or the current y = Y + v of (8)) and cells.

    Args:
        x: (m, gdim) node positions [length].
        cells: (n, k) node numbers: k = 2, or 3 at second order, of segments in the plane; in space
            3 or 6 of triangles, 4 or 9 of quads in cyclic order, nodes as of ``Element``.
            Neighbouring cells must be oriented alike; which of the two ways is found out from the
            bodies.
        v: (m, gdim) displacement of the nodes, in results [length]; (m, 1) of a scalar field.

    Raises:
        ContactInputError: for wrong shapes, node numbers out of range, unused nodes, NaN, cells
            that are inverted, degenerate, curved or turned against their neighbours.

    >>> frame = Frame([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], [[0, 1, 2, 3]])
    >>> at = frame.locate([[0.5, 0.5, 0.0]])
    >>> at.xi.tolist(), at.N.tolist()  # bilinear on [-1, 1]²
    ([[-0.5, 0.0]], [[0.375, 0.125, 0.125, 0.375]])
    >>> frame.interpolation(at) @ frame.x
    array([[0.5, 0.5, 0. ]])
    >>> frame.quality.max_angle, frame.quality.min_side
    (90.0, 1.0)
    """

    x: Given
    cells: Given
    v: Array | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        x, cells = _numbers("x", self.x, POSITIONS), _numbers("cells", self.cells, NUMBERS)
        x, cells = np.ascontiguousarray(x, np.float64), np.ascontiguousarray(cells, np.int64)
        object.__setattr__(self, "x", x)
        object.__setattr__(self, "cells", cells)
        if x.ndim != 2 or x.shape[1] not in (2, 3) or not len(x):
            raise ContactInputError(f"frame: x must be (m, 2) or (m, 3), is {x.shape}")
        kinds = (2, 3) if x.shape[1] == 2 else (3, 4, 6, 9)
        if cells.ndim != 2 or cells.shape[1] not in kinds or len(cells) == 0:
            raise ContactInputError(
                f"frame: cells must be (n, {' or '.join(map(str, kinds))}) node numbers with n > 0 "
                f"for nodes in {x.shape[1]}D, is {cells.shape}"
            )
        if cells.min() < 0 or cells.max() >= len(x):
            raise ContactInputError(
                f"frame: cells name nodes {cells.min()} to {cells.max()}, there are 0 to "
                f"{len(x) - 1}"
            )
        if not np.isfinite(x).all():
            raise ContactInputError(f"frame: {np.sum(~np.isfinite(x))} coordinates are not finite")
        unused = np.flatnonzero(np.bincount(cells.ravel(), minlength=len(x)) == 0)
        if len(unused):
            raise ContactInputError(f"frame: nodes {unused[:10].tolist()} belong to no cell")
        bad = np.flatnonzero(self._corner_jacobians.min(axis=1) <= 1e-8)
        if len(bad):
            raise ContactInputError(
                f"frame: cells {bad[:10].tolist()} are inverted or degenerate (corner Jacobian at "
                f"most 1e-8 of the cell's mean); first: nodes {cells[bad[0]].tolist()} at "
                f"{x[cells[bad[0]]].tolist()}"
            )
        _check_straight(self)
        _check_orientation(self)
        if self.v is not None:
            shape = (len(x), 1) if np.shape(self.v) == (len(x), 1) else x.shape
            v = checks.array("frame: v", self.v, shape, f"give {x.shape} displacements or None")
            object.__setattr__(self, "v", v)

    @classmethod
    def from_gmsh(
        cls, model: Any, physical_group: int, comm: MPI.Comm | None = None, gdim: int = 3
    ) -> Frame:
        """Frame from a physical group of a meshed gmsh model: surfaces, curves where gdim is 2.

        Args:
            model: gmsh.model; used on rank 0 only.
            physical_group: tag of the group.
            comm: MPI communicator, or None for a model that every rank has.
            gdim: dimension of the space.

        Raises:
            ContactInputError: no cells of one kind in the group; see ``Frame``.
        """
        if comm is None:
            return cls(*read_gmsh(model, physical_group, gdim))
        if not isinstance(comm, MPI.Comm):
            checks.refuse("comm", comm, "give an MPI communicator of mpi4py, or None")
        return chosen(comm, lambda: cls(*read_gmsh(model, physical_group, gdim)))

    @property
    def gdim(self) -> int:
        """Dimension of the space, 2 or 3."""
        return self.x.shape[1]

    @property
    def element(self) -> Element:
        """Shape functions of the cells."""
        return element_of(self.gdim - 1, self.cells.shape[1])

    @property
    def corners(self) -> Array:
        """(n_cells, c) nodes at the corners of the cells."""
        return self.cells[:, : self.element.corners]

    @cached_property
    def _corner_jacobians(self) -> Array:
        return corner_jacobians(self.x, self.corners)

    @cached_property
    def quality(self) -> Quality:
        """Corner angles, shortest side and Jacobian over all cells."""
        p = self.x[self.corners]
        if p.shape[1] == 2:
            side = np.linalg.norm(p[:, 1] - p[:, 0], axis=1)
            return Quality(180.0, 180.0, float(side.min()), 1.0)
        e = np.roll(p, -1, axis=1) - p
        b = -np.roll(e, 1, axis=1)
        angle = np.degrees(
            np.arctan2(np.linalg.norm(np.cross(e, b), axis=2), np.einsum("cki,cki->ck", e, b))
        )
        return Quality(
            float(angle.min()),
            float(angle.max()),
            float(np.linalg.norm(e, axis=2).min()),
            float(self._corner_jacobians.min()),
        )

    @cached_property
    def cell_size(self) -> Array:
        """(n_cells,) square root of the area (length in 2D) [length]."""
        return cell_sizes(self.x, self.corners)

    @cached_property
    def turns(self) -> Array:
        """(n_cells,) of ``cells.turns``."""
        return turns(self.x, self.corners)

    def moved(self, v: Array) -> Frame:
        """The frame where its nodes have moved to, y = Y + v of (8).

        Args:
            v: (m, gdim) displacement of the nodes [length].
        """
        x = self.x + v
        return replace(self, x=x, v=None) if self.element.order == 1 else bent(self, x)

    def flipped(self) -> Frame:
        """The same frame with its normal turned round."""
        corners = np.broadcast_to(np.arange(self.element.corners)[::-1], self.corners.shape)
        return replace(self, cells=self.element.permuted(self.cells, corners))

    def evaluate(self, cell: Array, xi: Array) -> tuple[Array, ...]:
        """Shape functions, positions and tangents at points of the frame, (23).

        Args:
            cell: (n,) frame cells.
            xi: (n, d) reference coordinates in them.

        Returns:
            N (n, k), positions (n, gdim) [length] and derivatives of the position by the
            reference coordinates (n, d, gdim) [length].
        """
        N, y, tangents = points_of(self.x, self.corners[cell], xi)
        return (N if self.element.order == 1 else self.element.shape(xi)[0]), y, tangents

    def locate(self, points: ArrayLike) -> Location:
        """Closest point of the frame for each given point (inverse isoparametric mapping).

        Beyond the closest point (outside the outline) the shape functions are continued by their
        gradient: they still sum to 1 and still reproduce linear fields. Where several cells share
        the closest point, it belongs to the first one.

        Args:
            points: (n, gdim) positions [length].

        Returns:
            A ``Location`` with one row per point.
        """
        accepted = f"give (n, {self.gdim}) positions"
        return self.places.locate(checks.array("points", points, (None, self.gdim), accepted))

    @cached_property
    def places(self) -> ClosestPoints:
        """Finds where points lie on the cells."""
        return ClosestPoints(self.x, self.corners)

    def interpolation(self, location: Location) -> csr_matrix:
        """(n, m) matrix of the shape functions N_J(xi_p): the scalar L_b before any design. Beyond
        the outline they are continued by the mean gradients of the cells around its nodes, and so
        vary continuously along it.

        Args:
            location: of n points, as ``locate`` gives it.
        """
        return self.places.interpolation(location, self.cells, self.element)


def bent(frame: Frame, x: Array) -> Frame:
    """A checked frame of second-order cells, which need not be straight, with its nodes at x
    (m, gdim) [length]."""
    found = object.__new__(Frame)
    for name, value in {"x": x, "cells": frame.cells, "v": None}.items():
        object.__setattr__(found, name, value)
    return found


def displaced(frame: Frame, v: Array) -> Frame:
    """A frame with displacements of its nodes beside their positions, for results.

    Args:
        frame: has been checked.
        v: (m, gdim) displacement of the nodes [length].
    """
    found = object.__new__(Frame)
    for name, value in {"x": frame.x, "cells": frame.cells, "v": v}.items():
        object.__setattr__(found, name, value)
    return found


def _check_straight(frame: Frame) -> None:
    """Nodes of second order must lie in the middle of their edges and cells."""
    between = frame.element.between(frame.x[frame.corners])
    off = np.abs(frame.x[frame.cells] - between).max(axis=(1, 2))
    bad = np.flatnonzero(off > MIDDLE * (frame.cell_size + np.abs(frame.x).max()))
    if len(bad):
        raise ContactInputError(
            f"frame: cells {bad[:10].tolist()} of second order are curved, by up to "
            f"{off.max():.3g}: made for nodes in the middle of straight edges. Give straight "
            "cells, numbered as gmsh does (corners, edges in turn, middle), or cells of first order"
        )


def _check_orientation(frame: Frame) -> None:
    """An edge (a node in 2D) of two cells must be run through once each way."""
    cells = frame.corners
    if cells.shape[1] == 2:
        counts = [np.bincount(c, minlength=len(frame.x)) for c in cells.T]
        bad = np.flatnonzero(np.maximum(*counts) > 1)
    else:
        edges = cells * len(frame.x) + np.roll(cells, -1, axis=1)  # one number each
        _, first, count = np.unique(edges, return_index=True, return_counts=True)
        bad = first[count > 1] // cells.shape[1]
    if len(bad):
        where = "nodes" if cells.shape[1] == 2 else "cells"
        raise ContactInputError(
            f"frame: neighbouring cells are turned against each other (inverted) or overlap "
            f"at {where} {bad[:10].tolist()}"
        )


def _numbers(name: str, value: Any, accepted: str) -> Array:
    """An array of real numbers, or of integers where numbers of nodes are asked for."""
    try:
        found = np.asarray(value)
    except ValueError:  # ragged
        found = np.empty(0, dtype=object)
    kinds = "iu" if accepted == NUMBERS and found.size else "iuf"
    if found.dtype.kind not in kinds:
        checks.refuse(f"frame: {name}", value, accepted)
    return found
