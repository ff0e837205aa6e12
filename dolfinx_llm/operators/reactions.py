"""Forces that (31) leaves open: at nodes that supports hold, and at those of several interfaces."""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import block_diag, csr_matrix, hstack

from dolfinx_llm.operators.prescribed import ColumnSpace, pieces
from dolfinx_llm.operators.system import ContactOperators

TOUCHING = 1e-9  # gaps up to this part of motions are none
VANISHES = 1e-6  # what is left of a sum of 1 where no forces press; of less rounding is not little
PULL = 1e-10  # part of the largest force below which a pull is rounding


def with_reactions(
    operators: ContactOperators,
    multiplier: np.ndarray,
    v: np.ndarray,
    u: np.ndarray,
    force: np.ndarray,
    friction: Sequence[tuple[np.ndarray, csr_matrix]] = (),
) -> np.ndarray:
    """Multipliers (n,) of which nothing is left to chance; collective.

    At nodes that supports hold, the equations leave open what the supports take and what goes
    through the frame; where nodes belong to several interfaces, what goes through which. Of all
    forces that move free dofs alike and leave the frames, and friction there, as they are, and of
    which those that may open press, these are the nearest to what bodies pass on: at nodes held
    f - K u (n_local,), in equal parts where interfaces share a node; else zero, which leads to the
    smallest forces. Those against obstacles stay as they are.

    Args:
        operators: of the interfaces.
        multiplier: λ (n,).
        v: (n_v,) frame unknowns.
        u: (n_local,) this rank's displacement.
        force: (n_local,) f - K u of all dofs, as without supports.
        friction: per interface its rows (n_i,) that bear friction, and what the nodes of its law
            feel of forces there (n_i, q); empty for ties.
    """
    motion, passed = (
        np.einsum("ni,ni->n", operators.rows.base, operators.dofs.values(operators.rows.dofs, a))
        for a in (u, force)
    )
    gaps = operators.row_gaps()
    opening = operators.L @ v - motion - gaps
    closed = opening <= TOUCHING * max(np.abs(motion).max(), np.abs(gaps).max())
    wanted = np.where(operators.held, passed / operators.interfaces_at, 0.0)
    chosen, presses, felt = *np.zeros((2, len(motion)), dtype=bool), []
    for i, (geometry, place) in enumerate(zip(operators.geometries, operators.places, strict=True)):
        law, c, L = geometry.interface.law, geometry.pairs[0].base.shape[1], operators.blocks[i]
        felt.append(L)
        if geometry.rigid or law.gives:  # where the law gives way it tells the forces
            continue
        own = np.ones(L.shape[0], dtype=bool)
        if not law.ties:
            own = closed[place.rows] & (np.arange(len(own)) % c == c - 1)
            presses[place.rows] = own & law.opens
            bears, of_friction = friction[i]
            wanted[place.rows][bears] = 0.0  # nothing tells friction: it is the least
            own, felt[i] = own | bears, hstack([L, of_friction])
        chosen[place.rows] = own
    at = np.flatnonzero(chosen & (operators.held | (operators.interfaces_at > 1)))
    fixed = hstack([block_diag(felt, format="csr")[at], operators.at_free_dofs(at)]).tocsr()
    multiplier, rounding = multiplier.copy(), PULL * np.abs(multiplier).max(initial=0.0)
    told = np.diff(fixed.indptr) > 0
    for own in pieces(fixed):
        if len(own) == 1 and told[own[0]]:  # its effect tells the force
            continue
        to = at[own]
        multiplier[to] = _nearest(fixed[own], multiplier[to], wanted[to], presses[to], rounding)
    return multiplier


def _nearest(
    fixed: csr_matrix, forces: np.ndarray, wanted: np.ndarray, presses: np.ndarray, rounding: float
) -> np.ndarray:
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
