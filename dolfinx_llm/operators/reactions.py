"""Forces at nodes that supports hold."""

import numpy as np

from dolfinx_llm.operators.prescribed import largest_share, undetermined
from dolfinx_llm.operators.system import ContactOperators

TOUCHING = 1e-9  # gaps up to this part of motions are none


def with_reactions(
    operators: ContactOperators,
    multiplier: np.ndarray,
    v: np.ndarray,
    u: np.ndarray,
    force: np.ndarray,
    sticks: np.ndarray | None = None,
) -> np.ndarray:
    """Multipliers (n,) with what bodies pass on at nodes that supports hold; collective.

    There the equations leave open what the supports take and what goes through the frame. Of the
    forces (n_local,) that bodies exert on both, f - K u, the part is added that leaves the frame in
    balance; what may open stays pressed together, and without it where it is open. What friction
    may be between nodes that stick, (n,) rows, nothing tells: it is the least that meets (31).
    Nodes of several interfaces, and those against obstacles, stay as they are.
    """
    rows, multiplier = operators.rows, multiplier.copy()
    motion, passed = (
        np.einsum("ni,ni->n", rows.base, operators.dofs.values(rows.dofs, local))
        for local in (u, force)
    )
    node = rows.dofs[:, 0]
    gaps = operators.row_gaps()
    opening = operators.L @ v - motion - gaps
    closed = opening <= TOUCHING * max(np.abs(motion).max(), np.abs(gaps).max())
    for model, place, L in zip(operators.models, operators.places, operators.blocks, strict=True):
        law, c = model.interface.law, model.pairs[0].base.shape[1]
        if model.frame is None or law.gives:  # where the law gives way it tells the forces
            continue
        others = np.delete(node, np.r_[place.rows])
        chosen = operators.held[place.rows] & ~np.isin(node[place.rows], others)
        if not law.ties:  # the law binds tangential forces
            normal = np.arange(len(chosen)) % c == c - 1
            if sticks is not None:
                loose = chosen & sticks[place.rows] & ~normal
                at = place.rows.start + np.flatnonzero(loose)
                multiplier[at] -= undetermined(L, loose, multiplier[at])
            chosen &= closed[place.rows] & normal
        at = place.rows.start + np.flatnonzero(chosen)
        rest = undetermined(L, chosen, passed[at] - multiplier[at])
        multiplier[at] += rest * (largest_share(multiplier[at], rest) if law.opens else 1.0)
    return multiplier
