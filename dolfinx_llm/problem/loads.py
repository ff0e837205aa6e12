"""Pressure on the part of a surface that another surface leaves free."""

from typing import Any

import numpy as np
from dolfinx import fem

from dolfinx_llm.base import checks
from dolfinx_llm.base.parallel import agree, collective
from dolfinx_llm.geometry.cells import facet_vectors
from dolfinx_llm.geometry.loads import NodalLoads
from dolfinx_llm.geometry.overlap_flat import common_area, common_plane
from dolfinx_llm.geometry.pieces import Piece, separated
from dolfinx_llm.geometry.spaces import check_space
from dolfinx_llm.geometry.surface import check_facet_tags, extract_surface
from dolfinx_llm.geometry.thickness import check_thickness
from dolfinx_llm.interface.touching import check_flat


def free_surface_load(
    V: fem.FunctionSpace,
    facet_tags: Any,
    tag: int,
    pressure: float,
    covered_by: tuple[Any, ...] | None = None,
    thickness: Any = None,
) -> fem.Function:
    """Energy-equivalent nodal forces of a uniform pressure on a flat surface.

    Where another surface covers part of it, its facets are clipped with that surface's outline and
    the shape functions integrated exactly over what is free.

    Args:
        V: vector function space of first or second order.
        facet_tags: mesh tags of facets.
        tag: the loaded surface.
        pressure: positive when it presses on the body [force / area].
        covered_by: (facet tags, tag) of a surface of the same mesh that covers part of it, or
            (function space, facet tags, tag) of one of another mesh, or None.
        thickness: of bodies in the plane, as of ``Interface`` [length].

    Returns:
        Function of V that holds nodal forces; pass it as ``nodal_loads``.

    Raises:
        ContactInputError: no such tag, a pressure that is not finite, arguments of other types, a
            thickness that is none.
        ContactError: the surfaces do not face each other or do not overlap, lie farther apart than
            the size of their largest facet, or are not flat.
    """
    check_space(V, highest=2)
    with collective(V.mesh.comm):
        checks.integer("facet tag", tag)
        check_thickness(thickness)
        pressure = checks.number("pressure", pressure, "must be a finite number")
        other_side = None if covered_by is None else _other(V, covered_by)
    agree(V.mesh.comm, "pressure and tags", (pressure, tag, other_side and other_side[2]))
    side = extract_surface(V, facet_tags, tag)
    with collective(V.mesh.comm):
        side = side.with_depth(thickness, "free_surface_load")
    nodal = np.zeros_like(side.x)
    np.add.at(nodal, side.cells, -pressure * facet_vectors(side.x, side.cells, side.thickness))
    if other_side is not None:
        if other_side[0] is not V:
            check_space(other_side[0], highest=2)
        other = extract_surface(*other_side)
        plane = common_plane(side, other)
        check_flat((side, other), plane, "what covers a surface lies across from it")
        whole = Piece((np.arange(len(side.facets)), np.arange(len(other.facets))), plane, 0)
        by_dof = np.argsort(side.dofs)
        for piece in separated(whole, (side, other)):
            own, over = piece.parts((side, other))
            area = common_area(own, over, plane)
            covered = NodalLoads.over(own, plane, area).forces
            at = by_dof[np.searchsorted(side.dofs, own.dofs, sorter=by_dof)]
            nodal[at] += pressure * np.outer(covered, plane.normal)
    load = fem.Function(V, name="load")
    mine = side.owner == V.mesh.comm.rank
    start = V.dofmap.index_map.local_range[0]
    gdim = side.x.shape[1]
    dofs = (side.dofs[mine] - start)[:, None] * gdim + np.arange(gdim)
    load.x.array[dofs.ravel()] = nodal[mine].ravel()
    load.x.scatter_forward()
    return load


def _other(V: fem.FunctionSpace, covered_by: Any) -> tuple[Any, Any, int]:
    """Function space, facet tags and tag of the surface that covers."""
    accepted = "give (facet tags, tag) or (function space, facet tags, tag), or None"
    given = checks.items("covered_by", covered_by, accepted)
    if len(given) not in (2, 3):
        checks.refuse("covered_by", covered_by, accepted)
    *space, tags, tag = given
    check_facet_tags("covered_by: facet tags", tags)
    return (space or [V])[0], tags, checks.integer("covered_by: tag", tag, accepted)
