"""Pressure on the part of a surface that another surface leaves free."""

from __future__ import annotations

from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.geometry.overlap_curved import facet_vectors
from dolfinx_llm.geometry.overlap_flat import common_area, common_plane, covered_forces, full_forces
from dolfinx_llm.geometry.surface import check_space, extract_surface


def free_surface_load(
    V: fem.FunctionSpace,
    facet_tags: Any,
    tag: int,
    pressure: float,
    covered_by: tuple | None = None,
) -> fem.Function:
    """Energy-equivalent nodal forces of a uniform pressure on a flat surface.

    Where another surface covers part of it, its facets are clipped with that surface's outline and
    the shape functions integrated exactly over what is free.

    Args:
        V: first-order vector function space.
        facet_tags: mesh tags of facets.
        tag: the loaded surface.
        pressure: positive when it presses on the body [force / area].
        covered_by: (facet tags, tag) of a surface of the same mesh that covers part of it, or
            (function space, facet tags, tag) of one of another mesh, or None.

    Returns:
        Function of V that holds nodal forces; pass it as ``nodal_loads``.

    Raises:
        ContactInputError: no such tag, a pressure that is not finite.
        ContactError: the surfaces do not face each other or do not overlap.
    """
    if not np.isfinite(pressure):
        raise ContactInputError(f"pressure={pressure}: must be finite")
    check_space(V)
    side = extract_surface(V, facet_tags, tag)
    if covered_by is None:
        forces = facet_vectors(side.x, side.facets)
    else:
        other = extract_surface(*(covered_by if len(covered_by) == 3 else (V, *covered_by)))
        plane = common_plane(side, other)
        s = plane.project(side.x)
        area = common_area(side, other, plane)
        free = full_forces(s, side.facets) - covered_forces(s, side.facets, area)
        forces = free[..., None] * plane.normal
    nodal = np.zeros_like(side.x)
    np.add.at(nodal, side.facets, -pressure * forces)
    load = fem.Function(V, name="load")
    mine = side.owner == V.mesh.comm.rank
    start = V.dofmap.index_map.local_range[0]
    gdim = side.x.shape[1]
    dofs = (side.dofs[mine] - start)[:, None] * gdim + np.arange(gdim)
    load.x.array[dofs.ravel()] = nodal[mine].ravel()
    load.x.scatter_forward()
    return load
