"""Mass taken off the surfaces that may meet, so that impact neither makes energy nor chatters.

A surface node that has mass meets an obstacle with an impulse, which no step in time resolves. As
of Khenous, Laborde and Renard (2008) the cells at the surface get no mass; the cells next to them
carry it, and the exponential of a polynomial over each body keeps its mass and centre, and its
moments of inertia where there are cells enough.
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
from dolfinx_llm.base.checks import place
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.log import log
from dolfinx_llm.base.parallel import check
from dolfinx_llm.operators.bodies import Bodies, body_labels
from dolfinx_llm.operators.motions import left_by_supports
from dolfinx_llm.time.given import check_mass

KEPT = 1e-10  # of a body's mass, to which moments are met before the last step
OFF = 0.01  # part of a moment of inertia up to which it is said to be met
NO_TURN = 1e-6  # part of a motion that is a turn, below which it is none
TRIES = 20  # steps of Newton's method
SOME = 1e-3  # of a cell's mass, the least that is left of it


def without_surfaces(
    spaces: Sequence[Any], densities: Sequence[Any], surfaces: Sequence[Any]
) -> tuple[list[Any], list[Array]]:
    """Per space the density, UFL, without what its surfaces had, and (n, 2) of ``moved_mass``, 1
    where it has none; collective, see there."""
    kept, eased = list(densities), [np.ones((V.dofmap.index_map.size_local, 2)) for V in spaces]
    for i, (V, own) in enumerate(zip(spaces, surfaces, strict=True)):
        if own:
            factor, eased[i] = moved_mass(V, densities[i], own)
            kept[i] = densities[i] * factor
    return kept, eased


def moved_mass(V: Any, rho: Any, surfaces: Sequence[tuple[Any, int]]) -> tuple[fem.Function, Array]:
    """Factor on the density, constant in each cell: 0 in cells at the surfaces; and for this rank's
    nodes (n, 2) the least and the largest of the moments of inertia that the body of each has then,
    over the true ones; collective.

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
    nodes, label = label[: V.dofmap.index_map.size_local], label[cells[:n, 0]]
    terms, values = _polynomials(V, own, cells[:n], label, count)
    moments = _integrals(V.mesh, rho, terms)
    check_mass(V.mesh.comm, mass := moments[:, 0])
    share = np.where(bare, 0.0, 1.0 + _received(V, cells[:n], bare, mass))
    share, fits = _corrected(V.mesh, values, moments, share, label, count)
    check(
        V.mesh.comm,
        not fits.all(),
        "a body is too thin for its mass to be taken off its surface: take at least four cells "
        'across it, tag less of its surface, or choose scheme="newmark"',
        ContactInputError,
    )
    factor.x.array[own[:n]] = share
    factor.x.scatter_forward()
    parts = (share[:, None] * moments, moments)
    sums = [_by_body(V.mesh.comm, part, label, count) for part in parts]
    return factor, _eased(sums, V.mesh.geometry.dim)[nodes]


def _eased(moments: Sequence[Array], gdim: int) -> Array:
    """(bodies, 2) the least and the largest moment of inertia over the true one, of (bodies, terms)
    moments as they are kept and as they are."""
    kept, true = (_polar(m[:, -(gdim * (gdim + 1) // 2) :], gdim) for m in moments)
    ratio = np.linalg.eigvals(np.linalg.solve(true, kept)).real
    return np.column_stack([ratio.min(axis=1), ratio.max(axis=1)])


def _polar(second: Array, gdim: int) -> Array:
    """(n, 1, 1) or (n, 3, 3) moments of inertia, of second moments (n, gdim (gdim + 1) / 2)."""
    M = np.zeros((len(second), gdim, gdim))
    M[:, *np.triu_indices(gdim)] = second
    trace = np.trace(M, axis1=1, axis2=2)[:, None, None]
    return trace if gdim == 2 else trace * np.eye(3) - M - np.triu(M, 1).swapaxes(1, 2)


def tell_of_turns(
    spaces: Sequence[Any], interfaces: Sequence[Any], eased: Sequence[Array], fixed: Array
) -> None:
    """Warn where a body that supports let turn turns more easily than it should; collective.

    Args:
        spaces: of the displacements.
        interfaces: with a thickness that is a function bodies have an axis, and do not turn.
        eased: per space (nodes, 2) of ``moved_mass``, of this rank's nodes.
        fixed: (n_local,) this rank's prescribed dofs.
    """
    if any(callable(i.thickness) for i in interfaces):
        return
    of_nodes, comm = np.concatenate(eased), spaces[0].mesh.comm
    if comm.allreduce(float(np.abs(of_nodes - 1.0).max(initial=0.0)), op=MPI.MAX) <= OFF:
        return
    bodies = Bodies(spaces)
    of, parts = left_by_supports(bodies, fixed)
    turning = of[np.abs(parts[:, bodies.gdim :]).max(axis=1, initial=0.0) > NO_TURN]
    ratio = np.full((2, bodies.count), np.inf)
    np.minimum.at(ratio[0], bodies.label, of_nodes[:, 0])
    np.minimum.at(ratio[1], bodies.label, -of_nodes[:, 1])
    comm.Allreduce(MPI.IN_PLACE, ratio, op=MPI.MIN)
    low, high, off = ratio[0], -ratio[1], np.zeros(bodies.count)
    off[turning] = np.maximum(1.0 - low, high - 1.0)[turning]
    b = int(off.argmax())
    if off[b] > OFF and comm.rank == 0:
        log.warning(
            "moments of inertia of the body about %s are %.2f to %.2f times the true ones, as its "
            "mass is taken off surfaces that may meet others: take more cells across it, tag less "
            'of its surface, or choose scheme="newmark"',
            place(0.5 * (bodies.low[b] + bodies.high[b])), low[b], high[b],
        )  # fmt: skip


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
    mesh: Any, values: Array, moments: Array, share: Array, label: Array, count: int
) -> tuple[Array, Array]:
    """(n,) shares times the exponentials of polynomials of the bodies with which sums of share
    times moments are those of 1: of second degree, else of mass, centre and polar moment, else of
    mass and centre, where all shares are left then; and (count,) whether any of these can be.

    Of all that meet the moments these differ from the shares the least by their entropy, and they
    are positive, where polynomials alone are not with fewer than some ten cells across.
    """
    comm, gdim, k = mesh.comm, mesh.geometry.dim, values.shape[1]
    polar = np.eye(k)[:, : gdim + 2]
    polar[:, -1] = np.isin(np.arange(k), _squares(gdim))
    best, takes = share, np.zeros(count, dtype=bool)
    for basis in (np.eye(k), polar, np.eye(k)[:, : gdim + 1]):
        found, met = _tilted(comm, values @ basis, moments @ basis, share, label, count)
        lowest = np.full(count, np.inf)
        np.minimum.at(lowest, label, np.where(share > 0.0, found, np.inf))
        comm.Allreduce(MPI.IN_PLACE, lowest, op=MPI.MIN)
        now = ~takes & met & (lowest > SOME) & np.isfinite(lowest)
        best, takes = np.where(now[label], found, best), takes | now
        if takes.all():
            break
    return best, takes


def _tilted(
    comm: MPI.Comm, values: Array, moments: Array, share: Array, label: Array, count: int
) -> tuple[Array, Array]:
    """(n,) shares times exp(values c), with c of each body such that sums of it times moments are
    those of 1, by Newton's method in steps of bounded exponents; (count,) where they are."""
    c = np.zeros((count, values.shape[1]))
    target = _by_body(comm, moments, label, count)
    for _ in range(TRIES):
        found = share * np.exp(np.einsum("nk,nk->n", values, c[label]))
        left = target - _by_body(comm, found[:, None] * moments, label, count)
        met = np.abs(left).max(axis=1) <= KEPT * target[:, 0]
        products = (found[:, None] * moments)[:, :, None] * values[:, None, :]
        A = _by_body(comm, products, label, count)
        step = np.array([np.linalg.lstsq(*ab, rcond=1e-10)[0] for ab in zip(A, left, strict=True)])
        far = np.ones(count)
        np.maximum.at(far, label, np.abs(np.einsum("nk,nk->n", values, step[label])))
        comm.Allreduce(MPI.IN_PLACE, far, op=MPI.MAX)
        c += step / far[:, None]
        if met.all():  # and by this step to rounding
            break
    return share * np.exp(np.einsum("nk,nk->n", values, c[label])), met


def _squares(gdim: int) -> list[int]:
    """Which of the monomials are squares."""
    k = 1 + gdim + gdim * (gdim + 1) // 2
    return [k - (gdim - i) * (gdim - i + 1) // 2 for i in range(gdim)]
