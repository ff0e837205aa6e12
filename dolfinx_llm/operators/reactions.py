"""Forces that (31) leaves open: at nodes that supports hold, and at those of several interfaces."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.sparse import block_diag, csr_matrix, diags, hstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.operators.guides import Guides
from dolfinx_llm.operators.prescribed import ColumnSpace, acting_on, pieces
from dolfinx_llm.operators.system import ContactOperators

Felt = Callable[[Array, float], csr_matrix]
TOUCHING = 1e-9  # gaps up to this part of motions are none
VANISHES = 1e-6  # what is left of a sum of 1 where no forces press; of less rounding is not little
DISCERNED = 1e-6  # of singular values, that tell a density
AREALESS = 1e-9  # part of the largest area, that tells no density
PULL = 1e-10  # part of the largest force below which a pull is rounding
UNLOADED = 1e-9  # part of the largest force, which counts at nodes where nothing presses


def with_reactions(
    operators: ContactOperators,
    multiplier: Array,
    v: Array,
    u: Array,
    force: Array,
    friction: Sequence[tuple[Array, Felt]] = (),
) -> Array:
    """Multipliers (n,) of which nothing is left to chance; collective.

    At nodes that supports hold, the equations leave open what the supports take and what goes
    through the frame; where nodes belong to several interfaces, what goes through which. Of all
    forces that move free dofs alike and leave the frames, and friction there, as they are, and of
    which those that may open press, these are the nearest to what bodies pass on: in ties alone the
    density of the nodes next to them, so that a constant one is found; at other nodes held
    f - K u (n_local,), in equal parts where interfaces share a node; else zero, which leads to the
    smallest forces, of friction as the normal force at the node has it. Those against obstacles
    stay as they are, but for obstacles that bodies cannot part from, which hold them as supports
    do, and take the rest.

    Args:
        operators: of the interfaces.
        multiplier: λ (n,).
        v: (n_v,) frame unknowns.
        u: (n_local,) this rank's displacement.
        force: (n_local,) f - K u of all dofs, as without supports.
        friction: per interface its rows (n_i,) that bear friction, and a function of its forces
            (n_i,) and of their level that returns what the nodes of its law feel (n_i, q), normal
            forces as well where they rub; empty for ties.
    """
    motion, passed = (
        np.einsum("ni,ni->n", operators.rows.base, operators.dofs.values(operators.rows.dofs, a))
        for a in (u, force)
    )
    gaps = operators.row_gaps()
    opening = operators.L @ v - motion - gaps
    closed = opening <= TOUCHING * max(np.abs(motion).max(), np.abs(gaps).max())
    wanted = np.where(operators.held, passed / operators.interfaces_at, 0.0)
    level = float(max(np.abs(a).max(initial=0.0) for a in (multiplier, wanted)))
    open_ = operators.held | (operators.interfaces_at > 1)
    areas, densities = np.zeros(len(motion)), np.zeros(len(motion), dtype=np.int64)
    # In ties alone it is what the nodes next to them say. Where contact shares a node, which of its
    # pairs press without force is for rounding to say, and the least is wanted of all.
    next_to, opens = wanted.copy(), np.ones(len(motion), dtype=bool)
    chosen, presses, guides, rubs, felt = *np.zeros((4, len(motion)), dtype=bool), []
    normal = np.arange(len(motion))  # of each row the normal one of its node
    for i, (geometry, place) in enumerate(zip(operators.geometries, operators.places, strict=True)):
        law, c, L = geometry.interface.law, geometry.pairs[0].base.shape[1], operators.blocks[i]
        guide = geometry.rigid and not (law.opens or law.gives or L.shape[1])
        guides[place.rows] = guide & (law.ties | (np.arange(L.shape[0]) % c == c - 1))
        opens[place.rows] = not (law.ties or guide)
        normal[place.rows] += c - 1 - np.arange(L.shape[0]) % c
        felt.append(L)
        if geometry.rigid or law.gives:  # where the law gives way it tells the forces
            continue
        own = np.ones(L.shape[0], dtype=bool)
        if not law.ties:
            own = closed[place.rows] & (np.arange(len(own)) % c == c - 1)
            presses[place.rows] = own & law.opens
            bears, of_friction = friction[i]
            wanted[place.rows][bears], rubs[place.rows] = 0.0, bears  # friction is the least
            own, felt[i] = own | bears, hstack([L, of_friction(multiplier[place.rows], level)])
            own &= ~np.repeat(geometry.prescribed, c)  # frame nodes of its own tell these
        else:
            rows = place.rows
            like, areas[rows] = _as_next(geometry.pairs, multiplier[rows], ~open_[rows])
            # Where no node tells a density the reaction does.
            held = operators.held[rows] & (areas[rows] > 0.0)
            areas[rows] = np.where(held, 0.0, areas[rows])
            next_to[rows] = np.where(held, wanted[rows], like)
            densities[rows] = i * operators.dofs.gdim + np.arange(len(own)) % c
        chosen[place.rows] = own
    nodes = operators.rows.dofs[:, 0]
    mixed = np.isin(nodes, nodes[opens])
    at = np.flatnonzero(chosen & open_)
    held_by = Guides.of(nodes, operators.free, np.flatnonzero(guides & np.isin(nodes, nodes[at])))
    free = acting_on(operators.rows.dofs[at], held_by.without(nodes[at], operators.free[at]))
    fixed = hstack([block_diag(felt, format="csr")[at], free]).tocsr()
    before, size = multiplier[at], np.abs(multiplier).max(initial=0.0)
    rounding = PULL * size
    multiplier = multiplier.copy()
    told = np.diff(fixed.indptr) > 0
    open_pieces = [own for own in pieces(fixed) if len(own) > 1 or not told[own[0]]]
    for own in open_pieces:  # the effect of others tells their force
        to = at[own]
        aim = wanted[to]
        if not mixed[to].any():
            _, column = np.unique(densities[to], return_inverse=True)
            same, aim = areas[to, None] * np.eye(column.max() + 1)[column], next_to[to]
            aim = aim + _constant(fixed[own], multiplier[to] - aim, same)
        multiplier[to] = _nearest(fixed[own], multiplier[to], aim, presses[to], rounding)
    for own in open_pieces:  # friction by normal forces, which are told by now
        own = own[rubs[at[own]]]
        pressed = np.maximum(multiplier[normal[at[own]]], max(UNLOADED * size, 1e-300))
        of = np.sqrt(pressed / pressed.max(initial=0.0))
        free = ColumnSpace((diags(of) @ fixed[own]).tocsr()).without(multiplier[at[own]] / of)
        multiplier[at[own]] -= of * free
    more = (multiplier[at] - before)[:, None] * operators.free[at]
    multiplier[held_by.rows] -= held_by.told(nodes[at], more)
    return multiplier


def _as_next(sides: Sequence[ContactPairs], forces: Array, known: Array) -> tuple[Array, Array]:
    """(n,) forces of ties, where they are not known as the density of the nodes next to them on
    facets has it, and (n,) areas where no node tells one, 0 elsewhere; there forces are 0.

    Args:
        sides: of the interface.
        forces, known: (n,) of its rows, whose bases are one per side, and whether they are known.
    """
    c, first = sides[0].base.shape[1], 0
    forces, known = np.where(known, forces, 0.0).reshape(-1, c), known.reshape(-1, c).copy()
    areas = np.zeros(forces.shape)
    for p in sides:
        own, (m, k) = slice(first, first + len(p.nodes)), p.cells.shape
        first, force, told, f = own.stop, forces[own], known[own], p.forces[:, None]
        at = np.ones(m * k), p.cells.ravel(), k * np.arange(m + 1)
        cells, last = csr_matrix(at, (m, len(f))), -1
        near = cells.T @ cells
        while told.sum() > last:
            area, last = near @ np.where(told, f, 0.0), told.sum()
            new = ~told & (area > AREALESS * f.max(initial=0.0))
            density = (near @ force) / np.where(new, area, 1.0)
            force[new], told[new] = (f * density)[new], True
        areas[own] = np.where(told, 0.0, f)
    return forces.ravel(), areas.ravel()


def _constant(fixed: csr_matrix, forces: Array, areas: Array) -> Array:
    """(k,) forces of densities that are the same at all areas (k, q) of each, nearest to what the
    effect of forces fixedᵀ λ (k,) tells of them."""
    if not areas.any():
        return np.zeros(len(forces))
    free = ColumnSpace(fixed).without
    seen, told = (a - free(a) for a in (areas, forces))
    return areas @ np.linalg.lstsq(seen, told, rcond=DISCERNED)[0]


def _nearest(
    fixed: csr_matrix, forces: Array, wanted: Array, presses: Array, rounding: float
) -> Array:
    """The forces (k,) nearest to those wanted that have the same effect fixedᵀ λ (q,) as others,
    where they press not negative beyond rounding [force]."""
    free = ColumnSpace(fixed).without
    found, forces = forces, forces + free(wanted - forces)
    size = np.abs(forces).max(initial=0.0)
    if not (forces[presses] < -rounding).any():
        return forces
    from scipy.optimize import nnls  # rarely needed, and a tenth of the time of all imports

    # Least distance, Lawson and Hanson, Solving Least Squares Problems (1974), chapter 23.
    P = free(np.eye(len(forces)))[presses]
    for allowed in (0.0, rounding):  # where rounding alone leaves none that press
        pulls = -(forces[presses] + allowed) / size
        try:
            x, _ = nnls(np.vstack([P.T, pulls]), np.eye(len(forces) + 1)[-1])
        except RuntimeError:  # too many iterations: then the forces stay as they were found
            return found
        left = 1.0 - x @ pulls
        if left > VANISHES:
            pressed = forces + size * free(P.T @ x) / left  # sums of large x are rough
            if not (pressed[presses] < -2.0 * rounding).any():
                return pressed
    return found
