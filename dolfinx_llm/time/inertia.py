"""Mass taken off the surfaces that may meet, so that impact neither makes energy nor chatters.

A surface node that has mass meets an obstacle with an impulse, which no step in time resolves. As of
Khenous, Laborde and Renard (2008) the cells at the surface get no mass; the cells next to them carry
it, and a polynomial of second degree over each body keeps its mass, centre and moments of inertia.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from dolfinx_llm.base import compat
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import check
from dolfinx_llm.operators.bodies import body_labels


def moved_mass(V: Any, rho: Any, surfaces: Sequence[tuple[Any, int]]) -> fem.Function:
    """Factor on the density, constant in each cell: 0 in cells at the surfaces; collective.

    Args:
        V: function space of the displacement.
        rho: density, UFL.
        surfaces: facet tags of V's mesh, and a tag.

    Raises:
        ContactInputError: a body is hardly thicker than its cells.
    """
    Q = compat.function_space(V.mesh, "DG", 0)
    factor, cells = fem.Function(Q, name="mass_factor"), compat.cell_dofs(V)
    n, own = V.mesh.topology.index_map(V.mesh.topology.dim).size_local, compat.cell_dofs(Q)[:, 0]
    bare = _at(V, surfaces)[cells[:n]].any(axis=1)
    label, count = body_labels(V)
    label, x = label[cells[:n, 0]], _centres(V, cells[:n])
    mass = _integrals(Q, [rho])[own[:n], 0]
    share = np.where(bare, 0.0, 1.0 + _received(V, cells[:n], bare, mass))
    terms, values = _polynomials(V.mesh, own, x, mass, label, count)
    moments = _integrals(Q, [rho * term for term in terms])[own[:n]]
    share *= 1.0 + _correction(V.mesh.comm, values, moments, share, label, count)
    check(
        V.mesh.comm,
        bool((share[~bare] <= 0.0).any()) or _empty(V.mesh.comm, bare, label, count),
        "a body is too thin for its mass to be taken off its surface: take at least four cells "
        'across it, tag less of its surface, or choose scheme="newmark"',
        ContactInputError,
    )
    factor.x.array[own[:n]] = share
    factor.x.scatter_forward()
    return factor


def _at(V: Any, surfaces: Sequence[tuple[Any, int]]) -> np.ndarray:
    """(nodes,) which of V's nodes on this rank, with ghosts, are on some tagged facets."""
    found = [np.zeros(0, dtype=np.int32)]
    dim = V.mesh.topology.dim - 1
    for tags, tag in surfaces:
        facets = tags.indices[tags.values == tag]
        found.append(fem.locate_dofs_topological(V, dim, facets))
    nodes = np.concatenate(found)
    return _summed(V, nodes, np.ones(len(nodes))) > 0.0


def _summed(V: Any, nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sum over all ranks of values at nodes, for this rank's nodes with ghosts."""
    vector = compat.ghosted_vector(V, 1)
    with vector.localForm() as local:
        local.array_w[:] = np.bincount(nodes.ravel(), values.ravel(), len(local.array_r))
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD_VALUES, mode=PETSc.ScatterMode.REVERSE)
    vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
    with vector.localForm() as local:
        total = local.array_r.copy()
    vector.destroy()
    return total


def _received(V: Any, cells: np.ndarray, bare: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """(n,) mass that cells get from those without, over their own: these pass it on in equal parts
    by their nodes that other cells share."""
    k = cells.shape[1]
    around = _summed(V, cells[~bare], np.repeat(mass[~bare], k))
    shared = around[cells[bare]] > 0.0
    parts = shared * (mass[bare] / np.maximum(shared.sum(axis=1), 1))[:, None]
    given = _summed(V, cells[bare], parts)
    return (given / np.where(around > 0.0, around, 1.0))[cells].sum(axis=1)


def _centres(V: Any, cells: np.ndarray) -> np.ndarray:
    """(n, gdim) middle of each cell's nodes."""
    x = V.tabulate_dof_coordinates()[:, : V.mesh.geometry.dim]
    return x[cells].mean(axis=1)


def _integrals(Q: Any, terms: Sequence[Any]) -> np.ndarray:
    """(n, terms) integrals of scalars over this rank's cells, by their dof of Q."""
    t, dx = ufl.TestFunction(Q), ufl.Measure("dx", domain=Q.mesh)
    forms = [compat.form("rho", term * t * dx) for term in terms]
    return np.column_stack([compat.assemble_force((form,), (1.0,), Q) for form in forms])


def _polynomials(
    mesh: Any, own: np.ndarray, x: np.ndarray, mass: np.ndarray, label: np.ndarray, count: int
) -> tuple[list[Any], np.ndarray]:
    """Monomials up to degree 2 about the centre of each cell's body, as UFL and (n, terms) in the
    middle of the cells."""
    comm, gdim = mesh.comm, mesh.geometry.dim
    total = _by_body(comm, mass[:, None], label, count)
    centre = _by_body(comm, mass[:, None] * x, label, count) / total
    far = np.sum((x - centre[label]) ** 2, axis=1)
    size = np.sqrt(_by_body(comm, (mass * far)[:, None], label, count) / total)
    about = fem.Function(compat.function_space(mesh, "DG", 0, (gdim,)))
    scale = fem.Function(compat.function_space(mesh, "DG", 0))
    about.x.array.reshape(-1, gdim)[own[: len(x)]] = centre[label]
    scale.x.array[own[: len(x)]] = size[label, 0]
    s, z = (ufl.SpatialCoordinate(mesh) - about) / scale, (x - centre[label]) / size[label]
    pairs = [(i, j) for i in range(gdim) for j in range(i, gdim)]
    terms = [1.0, *(s[i] for i in range(gdim)), *(s[i] * s[j] for i, j in pairs)]
    return terms, np.column_stack([np.ones(len(x)), z, *(z[:, i] * z[:, j] for i, j in pairs)])


def _by_body(comm: Any, values: np.ndarray, label: np.ndarray, count: int) -> np.ndarray:
    """(count, ...) sums of cells' values over the bodies, of all ranks."""
    total = np.zeros((count, *values.shape[1:]))
    np.add.at(total, label, values)
    return comm.allreduce(total)


def _correction(
    comm: Any,
    values: np.ndarray,
    moments: np.ndarray,
    share: np.ndarray,
    label: np.ndarray,
    count: int,
) -> np.ndarray:
    """(n,) polynomials c of the bodies with which sums of (1 + c) share moments are as before."""
    products = (share[:, None] * moments)[:, :, None] * values[:, None, :]
    A = _by_body(comm, products, label, count)
    missing = _by_body(comm, (1.0 - share)[:, None] * moments, label, count)
    c = np.array([np.linalg.lstsq(a, b, rcond=1e-10)[0] for a, b in zip(A, missing, strict=True)])
    return np.einsum("nk,nk->n", values, c[label])


def _empty(comm: Any, bare: np.ndarray, label: np.ndarray, count: int) -> bool:
    """Whether a body has no cell with mass."""
    return bool((_by_body(comm, ~bare * 1.0, label, count) == 0.0).any())
