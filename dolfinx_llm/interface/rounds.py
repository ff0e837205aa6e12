"""Which round obstacle a surface lies on: what to say where another one does not fit."""

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.geometry.cells import unit, vector_areas
from dolfinx_llm.geometry.surface import Surface

UNBENT = 1e-3  # part of the normals' spread that is none: along an axis, or of a flat surface


def round_advice(surface: Surface) -> str:
    """The sphere, or cylinder in 3D, on which all nodes lie within a tenth of its radius, as a
    sentence that goes on from another; "" where there is none.

    Args:
        surface: as drawn; bores and shafts alike.
    """
    x = surface.x + surface.origin
    areas = vector_areas(surface.x, surface.facets)
    spread, ways = np.linalg.eigh(np.einsum("fi,fj->ij", unit(areas), areas))
    bent = spread > UNBENT * spread[-1]
    if bent.sum() < 2 or len(x) <= 2 * (bent.sum() + 1):
        return ""  # flat, or few nodes, which always lie on a circle
    P, middle = ways[:, bent], x.mean(axis=0)
    y = np.einsum("ni,ik->nk", x - middle, P)
    size = np.abs(y).max()
    y /= size  # lengths stand beside ones
    fit = np.column_stack([2.0 * y, np.ones(len(y))])
    *centre, rest = np.linalg.lstsq(fit, np.einsum("nk,nk->n", y, y), rcond=None)[0]
    radius = float(np.sqrt(max(rest + np.dot(centre, centre), 0.0)))
    off = float(np.abs(np.linalg.norm(y - centre, axis=1) - radius).max())
    if not off < 0.1 * radius:
        return ""
    at = checks.place(middle + size * np.einsum("ik,k->i", P, centre))
    arms = y[surface.facets].mean(axis=1) - centre
    # Areas of a bore point in.
    away = float(np.einsum("fk,fi,ik->", arms, areas, P))
    inside = ", inside=True" if away > 0.0 else ""
    along = "" if bent.all() else f" {checks.place(ways[:, 0])},"
    kind = "RigidSphere" if bent.all() else "RigidCylinder"
    return (
        f". {surface.name} is round, within {size * off:.2g} of a llm.{kind}({at},{along} "
        f"{size * radius:.6g}{inside}): take that"
    )
