"""The proximal term, which holds frame nodes and slips where contact leaves them free."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from dolfinx_llm.contact.state import InterfaceState


def proximal_term(states: Sequence[InterfaceState], m: int, stiffness: float) -> csr_matrix:
    """(m, m) matrix of the proximal term -ε c (w - w_c).

    With friction each side's own field, v + κ and v - κ, is held as firmly as its pairs are.

    Args:
        states: of the interfaces.
        m: number of unknowns w.
        stiffness: ε c [force / length].
    """
    row, col, value = [np.empty(0, dtype=int)], [np.empty(0, dtype=int)], [np.empty(0)]

    def add(i: np.ndarray, j: np.ndarray, x: Any) -> None:
        row.append(i)
        col.append(j)
        value.append(-stiffness * x)

    for s in states:
        if not s.law.opens:
            continue
        nodes, tied, every = s.nodes, s.support(tied=True), s.support(tied=False)
        v = nodes.v.reshape(-1, max(nodes.geometry.directions.shape[1], 1))
        kappa = nodes.kappa if nodes.kappa.size else nodes.kappa[:, :0]
        if nodes.geometry.rigid:
            add(nodes.v, nodes.v, np.full(len(nodes.v), float(len(nodes.rows))))
        else:
            add(v[:, -1], v[:, -1], sum(every))
            for i in range(v.shape[1] - 1):
                add(v[:, i], v[:, i], sum(tied))
        at = range(v.shape[1])[s.law.components_of_jumps(v.shape[1])]
        for i, jump in enumerate(kappa.T):
            held = every if s.law.gives and i == kappa.shape[1] - 1 else tied
            if not nodes.geometry.rigid:
                add(v[:, at[i]], jump, held[0] - held[1])
                add(jump, v[:, at[i]], held[0] - held[1])
            add(jump, jump, sum(held))
    index = np.concatenate(row), np.concatenate(col)
    return coo_matrix((np.concatenate(value), index), (m, m)).tocsr()
