"""Forces of unit pressure by which rows are designed: both sides' of the same area.

A pressure passes where surfaces touch. Elsewhere between them the areas of both sides differ by the
gap over the radius, and by what one side stretches more: smoothly. Corrections of rows hardly
change what varies slowly along a frame, so that balancing such differences took large ones, which
moved gaps. In the plane, therefore, a facet of the moving side counts with the length of the frame
that it covers.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, summing
from dolfinx_llm.finite.frame.covered import with_thickness
from dolfinx_llm.finite.frame.sides import Meeting, Sides


def balanced_loads(
    sides: Sides, meeting: Meeting, z: Array, own: tuple[Array, csr_matrix]
) -> tuple[tuple[Array, Array], tuple[csr_matrix, csr_matrix]]:
    """(n,) and (m,) of the nodes of the moving side and of the frame [area], and derivatives.

    Args:
        sides: of an interface.
        meeting: how they meet.
        z: all coordinates [length].
        own: ``Sides.forces`` of the moving side.
    """
    if meeting.along is not None:
        own = _along(sides, meeting, z, *meeting.along)
    forces = own, sides.forces(meeting, z, False)
    C = [control.T for control in sides.control]
    values, by_z = ([M @ a for M, a in zip(C, of)] for of in zip(*forces, strict=True))
    return (values[0], values[1]), (by_z[0].tocsr(), by_z[1].tocsr())


def _along(
    sides: Sides, meeting: Meeting, z: Array, length: Array, by_z: csr_matrix
) -> tuple[Array, csr_matrix]:
    """(n,) of the moving side's control values: a facet's length on the frame, parted as what is
    covered of the facet itself, with its thickness."""
    covered, surface = meeting.covered[0], sides.mover
    thick = with_thickness(covered, sides.split(z)[0], surface, sides.first[0])
    share, cells = thick.share, surface.cells
    part = covered.share.sum(axis=1)
    inverse = np.where(part > 0.0, 1.0 / np.where(part > 0.0, part, 1.0), 0.0)
    own = share * inverse[:, None]
    of_facet = _sums(share)
    change = thick.derivative
    parted = _sums(covered.share) @ covered.derivative
    change = change - diagonal(own.ravel()) @ of_facet.T @ parted
    change = diagonal(np.repeat(length * inverse, share.shape[1])) @ change
    change = change + diagonal(own.ravel()) @ of_facet.T @ by_z
    gather = summing(cells.ravel(), len(sides.mover.x))
    return gather @ (own * length[:, None]).ravel(), gather @ change


def _sums(share: Array) -> csr_matrix:
    """(f, f k) sums over the functions of each facet."""
    f, k = share.shape
    return summing(np.repeat(np.arange(f), k), f)
