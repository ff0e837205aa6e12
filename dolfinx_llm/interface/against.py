"""A body against a rigid obstacle: every surface node against its point of the obstacle.

Motions of an obstacle under prescribed forces and moments are unknowns, as a frame node's are.
"""

from dataclasses import replace

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import chosen
from dolfinx_llm.geometry.cells import areas_around, vector_areas
from dolfinx_llm.geometry.facing import BEYOND, TURN, Facets, facet_sizes
from dolfinx_llm.geometry.loads import NodalLoads
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.interface.obstacle import Obstacle, Swings
from dolfinx_llm.interface.obstacles import MeanDisplacement, RigidSurface, about_the_mean
from dolfinx_llm.interface.touching import BURIED, say_depth, steep_rim
from dolfinx_llm.laws.law import Law

RESISTED = 1e-6  # part of the largest: below it a motion meets no resistance of contact
REST = 1e-9  # part of a force that rounding may put across what contact resists


def against_obstacle(
    obstacle: Obstacle, side: Surface, name: str, notes: list[str]
) -> tuple[ContactPairs, Array]:
    """The pairs of a body against a rigid obstacle, nodes of facets that face it, and (n,) nodes at
    a rim that is too steep.

    Raises:
        ContactError: no facet faces the obstacle, or the body lies inside of it.
        ContactInputError: the obstacle is of another dimension, or its clearance is no clearance.
    """
    gdim, kind = side.x.shape[1], type(obstacle).__name__
    distance, normal = checked_clearance(obstacle, side.x)
    facets = np.arange(len(side.facets))
    if obstacle.everywhere:
        normal = areas_around(side.x, side.facets, side.cells)
        normal /= np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None]
    else:
        facets = _facing_facets(side, distance, normal)
    if not len(facets):
        near = int(distance.argmin())
        raise ContactError(
            f"no node of {side.name} faces the {kind}: seen from the body it must lie on the outer "
            f"side of the surface. The nearest node, {checks.place(side.x[near])}, has the "
            f"clearance {distance[near]:.3g}. Check the obstacle's normal, `inside`, the tag and "
            "positions"
        )
    loads = NodalLoads.whole(side, facets)
    facing = np.zeros(len(side.x), dtype=bool)
    facing[side.cells[facets]] = True
    nodes = np.flatnonzero(facing & np.isfinite(distance))
    pairs = ContactPairs(
        surface=side,
        nodes=nodes,
        loads=loads.of(nodes),
        cell=np.zeros(len(nodes), dtype=np.int64),
        N=csr_matrix((len(nodes), 0)),
        normal=normal[nodes],
        base=np.broadcast_to(np.eye(gdim), (len(nodes), gdim, gdim)).copy(),
        gap=-distance[nodes, None] * normal[nodes],
    )
    if isinstance(obstacle, MeanDisplacement):
        notes.append(f"{kind}: of {len(nodes)} nodes, under a uniform traction")
    else:
        notes.append(f"rigid {kind}: {len(nodes)} nodes face it")
    if len(facets) < len(side.facets):
        notes.append(
            f"{len(side.facets) - len(facets)} of {len(side.facets)} facets of {side.name} left "
            "out: they do not face the obstacle"
        )
    # It may be drawn inside and moved away, or drawn at the surface and pressed in.
    moved = distance.copy()
    moved[nodes] += np.maximum(np.einsum("ni,ni->n", pairs.normal, obstacle.motion(pairs.met)), 0.0)
    _say_place(obstacle, side, nodes, moved, name, notes)
    return pairs, steep_rim(side, facets, np.isfinite(distance))


def as_drawn(geometry: InterfaceGeometry) -> list[Array]:
    """What an interface takes a rigid obstacle to be: clearance of the surface's nodes (n,) and its
    directions (n, gdim), or the mesh by which these take long to find; of an end that turns under a
    moment its pivot; nothing without one."""
    obstacle, x = geometry.interface.obstacle, geometry.sides[0].x
    if obstacle is None:
        return []
    pivot = [] if geometry.swings is None else [np.array(obstacle.pose(x.shape[1])[2])]
    if type(obstacle) is RigidSurface:
        return [obstacle.mesh.x.copy(), obstacle.mesh.cells.copy(), *pivot]
    return [*checked_clearance(obstacle, x), *pivot]


def checked_clearance(obstacle: Obstacle, x: Array) -> tuple[Array, Array]:
    """What the obstacle says of points, checked: own obstacles may say anything."""
    gdim, kind = x.shape[1], type(obstacle).__name__
    if obstacle.gdim not in (None, gdim):
        raise ContactInputError(f"the {kind} lies in {obstacle.gdim}D, the body in {gdim}D")
    try:
        distance, normal = obstacle.clearance(x)
        distance, normal = np.array(distance, float), np.array(normal, float)
    except (TypeError, ValueError) as error:
        if isinstance(error, ContactInputError):
            raise
        raise ContactInputError(f"{kind}.clearance(x) fails: {error}; {WANTED}") from error
    if distance.shape != (len(x),) or normal.shape != x.shape:
        raise ContactInputError(
            f"{kind}.clearance(x) of {len(x)} points gives shapes {distance.shape} and "
            f"{normal.shape}; {WANTED}"
        )
    there = np.isfinite(distance)
    length = np.linalg.norm(normal[there], axis=1)
    if np.isnan(distance).any() or (distance == -np.inf).any() or np.isnan(length).any():
        raise ContactInputError(f"{kind}.clearance(x) gives NaN or -inf; {WANTED}")
    if there.any() and np.abs(length - 1.0).max() > 1e-6:
        raise ContactInputError(
            f"{kind}.clearance(x) gives directions of length {length.min():.6g} to "
            f"{length.max():.6g}; {WANTED}"
        )
    return distance, np.where(there[:, None], normal, 0.0)


WANTED = (
    "it must return (n,) distances, negative inside the obstacle, inf where there is none of it, "
    "and (n, gdim) unit vectors into it"
)


def _facing_facets(side: Surface, distance: Array, normal: Array) -> Array:
    """Numbers of the facets that face the obstacle and lie near."""
    direction = normal[side.facets].sum(axis=1)
    direction /= np.maximum(np.linalg.norm(direction, axis=1), 1e-300)[:, None]
    area = vector_areas(side.x, side.facets)
    cosine = np.einsum("fi,fi->f", area, direction) / np.linalg.norm(area, axis=1)
    faces = cosine > np.cos(TURN)
    at = distance[side.cells].min(axis=1)
    if side.element.order > 1:  # a facet takes part as a whole
        at[~np.isfinite(distance[side.cells]).all(axis=1)] = np.inf
    limit = at[faces].min(initial=np.inf) + BEYOND * Facets.of(side).reach
    return np.flatnonzero(faces & np.isfinite(at) & (at <= limit))


def _say_place(
    obstacle: Obstacle,
    side: Surface,
    nodes: Array,
    distance: Array,
    name: str,
    notes: list[str],
) -> None:
    """How far the body is from the obstacle, or how deep inside of it: refused at half of it. The
    nodes face the obstacle; the distance (n,) is that of all nodes."""
    kind, depth = type(obstacle).__name__, np.zeros(len(distance))
    depth[nodes] = np.maximum(-distance[nodes], 0.0)
    if depth.max() <= 1e-9 * side.diameter:
        near = nodes[distance[nodes].argmin()]
        if distance[near] > 1e-9 * side.diameter:
            notes.append(
                f"not touching as drawn: nearest at {checks.place(side.x[near])}, "
                f"{distance[near]:.3g} from the {kind}"
            )
        return
    say_depth(
        side, depth, facet_sizes(side), BURIED * Facets.of(side).reach, name, notes,
        what=f"the {kind}",
        wrong="the body lies inside of the obstacle. Check positions, units, the obstacle's "
        "normal, `inside` and displacement",
        pushes="it out",
    )  # fmt: skip


def loaded(obstacle: Obstacle, gdim: int) -> tuple[bool, ...]:
    """Per component of displacement and rotation whether a force or moment is prescribed."""
    force, moment = obstacle.pose(gdim)[3:]
    return tuple(f is not None for f in force + moment)


def forces_on(obstacle: Obstacle, before: tuple[bool, ...], gdim: int) -> Array:
    """Force and moment on an obstacle now, 0 where none is prescribed [force, force length].

    Raises:
        ContactInputError: it is prescribed for other components than it was ``before``.
    """
    force, moment = obstacle.pose(gdim)[3:]
    given = force + moment
    if tuple(f is not None for f in given) != before:
        raise ContactInputError(
            f"force={force}, moment={moment} of the {type(obstacle).__name__}: when the problem "
            f"was made, they were prescribed by component as {before}. Make the problem anew to "
            "change that"
        )
    return np.array([0.0 if f is None else f for f in given])


def under_force(
    obstacle: Obstacle, pairs: ContactPairs, comm: MPI.Comm
) -> tuple[ContactPairs, Array, Swings | None]:
    """Motions of an obstacle that forces and moments are prescribed for, as those of a frame of one
    node: the pairs, whose rows all see that node, (1, d, gdim) directions in which it moves, and
    how it turns: the prescribed components, or what of them contact can resist. No force:
    (0, c, gdim)."""
    if isinstance(obstacle, MeanDisplacement):
        return *about_the_mean(obstacle, pairs), None
    n, c, gdim = pairs.base.shape
    given = loaded(obstacle, gdim)
    axes = np.eye(len(given))[list(given)]
    if not len(axes):
        return pairs, np.empty((0, c, gdim)), None
    swings = Swings.of(obstacle, pairs.met, axes[:, gdim:])
    seen = np.einsum("nci,ndi->ncd", pairs.base, axes[:, :gdim] + swings.motions)
    seen = seen.reshape(n * c, -1)
    size, vectors = chosen(comm, lambda: np.linalg.svd(seen, full_matrices=False)[1:])
    resisted = size > RESISTED * max(size[0], 1.0)  # of unit vectors
    if not resisted.any():
        return pairs, np.empty((0, c, gdim)), None
    if not resisted.all() or len(size) < len(axes):
        axes = vectors[: int(resisted.sum())] @ axes
        swings = Swings.of(obstacle, pairs.met, axes[:, gdim:])
    pairs = replace(pairs, N=csr_matrix(np.ones((n, 1))))
    return pairs, axes[None, :, :gdim], swings if swings.turns.any() else None


def prescribed_loads(geometry: InterfaceGeometry) -> Array:
    """(m d,) loads on the frame unknowns of an interface, L_bᵀ λ = loads, as they are now: zeros at
    a frame, minus the force at an obstacle [force]."""
    obstacle, axes, swings = geometry.interface.obstacle, geometry.directions, geometry.swings
    loads = np.zeros(axes.shape[0] * axes.shape[1])
    if obstacle is None:
        return loads
    if isinstance(obstacle, MeanDisplacement):
        check_mean(obstacle, axes[0])
    values = forces_on(obstacle, geometry.forced, axes.shape[2])
    if not any(geometry.forced):
        return loads
    ways = axes.reshape(-1, axes.shape[2])
    if swings is not None:
        ways = np.hstack([ways, swings.turns])
    values = values[: ways.shape[1]]  # in units of force
    if swings is not None:
        values[axes.shape[2] :] /= swings.size
    along = ways @ values
    left = values - along @ ways
    check_resisted(left, values, obstacle, before=f"interface {geometry.interface.name}: ")
    return -along


def check_tied_to_mean(name: str, obstacle: Obstacle, law: Law) -> None:
    """Require the law that goes with a prescribed mean.

    Raises:
        ContactInputError: it is another one, on the interface of this name.
    """
    if obstacle.everywhere and not law.ties:
        raise ContactInputError(
            f"interface {name}: a mean displacement is prescribed with law=Tied()"
        )


def check_mean(mean: MeanDisplacement, before: Array) -> None:
    """Require that components are prescribed along the same axes (c, gdim) as ``before``.

    Raises:
        ContactInputError: they are not.
    """
    if not np.array_equal(mean.axes(before.shape[1]), before):
        raise ContactInputError(
            f"mean={mean.mean}: when the problem was made, other components were prescribed. "
            "Make the problem anew to change that"
        )


def check_resisted(
    left: Array, force: Array, obstacle: Obstacle, before: str = "", after: str = ""
) -> None:
    """Require that contact resists a force on an obstacle but for rounding.

    Args:
        left: (k,) part of the force across what contact resists [force].
        force: (k,) [force].
        obstacle: on which it acts.
        before, after: words about the place and the components.

    Raises:
        ContactError: it does not.
    """
    if np.abs(left).max() > REST * np.abs(force).max():
        raise ContactError(
            f"{before}nothing resists the part {left.round(9).tolist()} of the force "
            f"{force.tolist()} on the {type(obstacle).__name__}{after}. Give None for components "
            "whose displacement is prescribed, or take a law with friction"
        )
