"""Mass taken off the surfaces that may meet, so that impact neither makes energy nor chatters.

A surface node that has mass meets an obstacle with an impulse, which no step in time resolves. As
of Khenous, Laborde and Renard (2008) the cells at the surface get no mass; the cells next to them
carry it, and a polynomial over each body keeps its mass and centre, and its moments of inertia
where there are cells enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from dolfinx_llm.base import compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import check
from dolfinx_llm.operators.bodies import body_labels
from dolfinx_llm.time.given import check_mass

KEPT = 1e-10  # of a body's mass, to which moments are met
SOME = 0.01  # of a cell's mass: in regular bodies 3 to 5 cells across 0 to rounding is left of it


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
    label = label[cells[:n, 0]]
    terms, values = _polynomials(V, own, cells[:n], label, count)
    moments = _integrals(V.mesh, rho, terms)
    check_mass(V.mesh.comm, mass := moments[:, 0])
    share = np.where(bare, 0.0, 1.0 + _received(V, cells[:n], bare, mass))
    share, fits = _corrected(V.mesh, values, moments, share, label, count)
    check(
        V.mesh.comm,
        not fits,
        "a body is too thin for its mass to be taken off its surface: take at least four cells "
        'across it, tag less of its surface, or choose scheme="newmark"',
        ContactInputError,
    )
    factor.x.array[own[:n]] = share
    factor.x.scatter_forward()
    return factor


def _at(V: Any, surfaces: Sequence[tuple[Any, int]]) -> Array:
    """(nodes,) which of V's nodes on this rank, with ghosts, are on some tagged facets."""
    found = [np.zeros(0, dtype=np.int32)]
    dim = V.mesh.topology.dim - 1
    for tags, tag in surfaces:
        facets = tags.indices[tags.values == tag]
        found.append(fem.locate_dofs_topological(V, dim, facets))
    nodes = np.concatenate(found)
    return _summed(V, nodes, np.ones(len(nodes))) > 0.0


def _summed(V: Any, nodes: Array, values: Array) -> Array:
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


def _received(V: Any, cells: Array, bare: Array, mass: Array) -> Array:
    """(n,) mass that cells get from those without, over their own: these pass it on in equal parts
    by their nodes that other cells share."""
    k = cells.shape[1]
    around = _summed(V, cells[~bare], np.repeat(mass[~bare], k))
    shared = around[cells[bare]] > 0.0
    parts = shared * (mass[bare] / np.maximum(shared.sum(axis=1), 1))[:, None]
    given = _summed(V, cells[bare], parts)
    return (given / np.where(around > 0.0, around, 1.0))[cells].sum(axis=1)


def _integrals(mesh: Any, rho: Any, terms: Sequence[Any]) -> Array:
    """(n, terms) integrals of rho times scalars over this rank's cells."""
    Q = compat.function_space(mesh, "DG", 0, (len(terms),))
    t = ufl.TestFunction(Q)
    form = compat.form("rho", rho * ufl.inner(ufl.as_vector(terms), t) * ufl.dx(domain=mesh))
    found = compat.assemble_force((form,), (1.0,), Q).reshape(-1, len(terms))
    return found[compat.cell_dofs(Q)[: len(found), 0]]


def _polynomials(
    V: Any, own: Array, cells: Array, label: Array, count: int
) -> tuple[list[Any], Array]:
    """Monomials up to degree 2 about the middle of each cell's body, as UFL and (n, terms) in the
    middle of the cells; 1 is the first."""
    mesh, comm, gdim = V.mesh, V.mesh.comm, V.mesh.geometry.dim
    nodes = V.tabulate_dof_coordinates()[:, :gdim][cells]
    x, volume = nodes.mean(axis=1), np.ptp(nodes, axis=1).prod(axis=1)[:, None]  # of their boxes
    total = _by_body(comm, volume, label, count)
    centre = _by_body(comm, volume * x, label, count) / total
    far = np.sum((x - centre[label]) ** 2, axis=1)[:, None]
    size = np.sqrt(_by_body(comm, volume * far, label, count) / total)
    about = fem.Function(compat.function_space(mesh, "DG", 0, (gdim,)))
    scale = fem.Function(compat.function_space(mesh, "DG", 0))
    about.x.array.reshape(-1, gdim)[own[: len(x)]] = centre[label]
    scale.x.array[own[: len(x)]] = size[label, 0]
    s, z = (ufl.SpatialCoordinate(mesh) - about) / scale, (x - centre[label]) / size[label]
    pairs = [(i, j) for i in range(gdim) for j in range(i, gdim)]
    terms = [1.0, *(s[i] for i in range(gdim)), *(s[i] * s[j] for i, j in pairs)]
    return terms, np.column_stack([np.ones(len(x)), z, *(z[:, i] * z[:, j] for i, j in pairs)])


def _by_body(comm: Any, values: Array, label: Array, count: int) -> Array:
    """(count, ...) sums of cells' values over the bodies, of all ranks."""
    total = np.zeros((count, *values.shape[1:]))
    np.add.at(total, label, values)
    return comm.allreduce(total)


def _corrected(
    mesh: Any,
    values: Array,
    moments: Array,
    share: Array,
    label: Array,
    count: int,
) -> tuple[Array, bool]:
    """(n,) shares times polynomials of the bodies with which sums of share times moments are those
    of 1: of second degree, else of mass, centre and polar moment, else of mass and centre, where
    all shares are left then; and whether that can be."""
    comm, gdim, k = mesh.comm, mesh.geometry.dim, values.shape[1]
    products = (share[:, None] * moments)[:, :, None] * values[:, None, :]
    A = _by_body(comm, products, label, count)
    missing = _by_body(comm, (1.0 - share)[:, None] * moments, label, count)
    squares = [k - 1 - (gdim - i) * (gdim - i + 1) // 2 + 1 for i in range(gdim)]
    polar = np.eye(k)[:, : gdim + 2]
    polar[:, -1] = np.isin(np.arange(k), squares)
    best, least = share, np.zeros(count)
    for basis in (np.eye(k), polar, np.eye(k)[:, : gdim + 1]):
        a, b = basis.T @ A @ basis, missing @ basis
        c = np.array([np.linalg.lstsq(*ab, rcond=1e-10)[0] for ab in zip(a, b, strict=True)])
        met = np.abs(np.einsum("bij,bj->bi", a, c) - b).max(axis=1) <= KEPT * a[:, 0, 0]
        found = share * (1.0 + np.einsum("nk,nk->n", values @ basis, c[label]))
        lowest = np.full(count, np.inf)
        np.minimum.at(lowest, label, np.where(share > 0.0, found, np.inf))
        comm.Allreduce(MPI.IN_PLACE, lowest, op=MPI.MIN)
        takes = met & (least <= SOME) & np.isfinite(lowest)
        best, least = np.where(takes[label], found, best), np.where(takes, lowest, least)
    return best, bool((least > SOME).all())
