"""Tractions at the nodes of second-order surfaces where they stand now, from the forces there: see
``density_at_nodes``."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.loads import NodalLoads, covered_loads
from dolfinx_llm.geometry.pairs import ContactPairs, control_matrices
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.density import density_at_nodes

UNCOVERED = 1e-9  # of the largest area of a control value: below it nothing is covered


def densities(
    surfaces: Sequence[Surface],
    x: Sequence[Array],
    area: Sequence[Array],
    force: Sequence[Array],
    normal: Sequence[Array],
    mean: Sequence[Array],
    presses: bool,
) -> list[Array | None]:
    """Per side (n, gdim) the traction that its body exerts, 0 where the other one does not cover
    it [force / area]; None at first order, where it is force per area.

    Args:
        surfaces: as drawn; one against an obstacle, which covers all that has an area.
        x: per side (n, gdim) nodes now [length].
        area: (n,) of them, as forces of unit pressure [area].
        force: (n, gdim) forces at nodes.
        normal: (n, gdim) out of the side.
        mean: (n, gdim) force per area about each node [force / area].
        presses: no pair pulls.
    """
    if all(s.element.order == 1 for s in surfaces):
        return [None] * len(surfaces)
    E = [control_matrices(s)[0] for s in surfaces]
    felt = [e.T @ a for e, a in zip(E, area, strict=True)]
    touched = [
        np.flatnonzero((f > UNCOVERED * f.max(initial=0.0))[s.cells].all(axis=1))
        for f, s in zip(felt, surfaces, strict=True)
    ]
    now = [s.moved(p - s.X).part(t) for s, p, t in zip(surfaces, x, touched, strict=True)]
    found: list[Array | None] = []
    for k, surface in enumerate(surfaces):
        if surface.element.order == 1:
            found.append(None)
            continue
        value = np.zeros_like(force[k])
        found.append(value)
        if not all(map(len, touched)):
            continue
        if len(now) == 1:
            loads = NodalLoads.whole(now[0], np.arange(len(touched[0])))
        else:
            loads, _ = covered_loads(now[k], now[1 - k], np.inf, 1, as_is=True)
        nodes = np.unique(surface.cells[touched[k]])
        pairs = _pairs(now[k], loads, normal[k][nodes])
        borne = (E[k].T @ force[k])[nodes]
        value[nodes] = density_at_nodes(pairs, borne, presses, mean[k][nodes])
    return found


def _pairs(surface: Surface, loads: NodalLoads, normal: Array) -> ContactPairs:
    """Of all nodes of a surface, of whose control values forces are, by themselves."""
    n, gdim = surface.x.shape
    return ContactPairs(
        surface=surface,
        nodes=np.arange(n),
        loads=loads,
        cell=np.zeros(n, dtype=np.int64),
        N=csr_matrix((n, 0)),
        normal=normal,
        base=np.broadcast_to(np.eye(gdim), (n, gdim, gdim)),
        gap=np.zeros((n, gdim)),
        control=control_matrices(surface)[0],
    )
