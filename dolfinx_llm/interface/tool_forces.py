"""Forces at the nodes of a side that supports move as a whole and that carries the frame.

They change nothing of the bodies, which see their resultant and moment alone. Rows would bring what
presses beside the tool's rim to its nodes by weights of both signs, and to few of many. Instead
each force F_p is shared by the nodes J opposite of its surroundings, by weights r_pJ, none
negative: what presses everywhere presses everywhere on the tool, within the same cone of friction,
and a constant pressure is one on it. Of all weights that keep the moment they are those of maximum
entropy about w_pJ, which go with areas and shape functions:

    r_pJ = w_pJ exp(alpha·m_pJ / |F_p|) / Z_p,    m_pJ = (y_J - x_p) x F_p,

with one alpha for all; with one for each point they are shape functions (Arroyo and Ortiz, Int. J.
Numer. Meth. Engng 65 (2006) 2167-2202).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix, diags

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.interface.forces import moments, per_area

SHARINGS = 500  # of the weights to the areas of both sides in turn, at most
AREA_MISSED = 1e-14  # of all area: what these may differ by
SHARE_ROUNDED = 1e-9  # of the largest area, and of 1 of shape functions: less is rounding
THINLY = 1e-2  # of what rows say, for pairs that no nodes lie opposite of
MOMENT_KEPT = 1e-12  # of all force times the size: what moments may differ by
TILTS = 50  # of Newton's iteration for alpha
HALVES = 20  # of one of them
PROMISED = 1e-4  # part of what a step promises, that it must bring, but for
VALUE_ROUNDED = 1e-15
NO_CURVATURE = 1e-12  # of the largest: moments that no weights change
TOOL_PULLS = 1e-3  # of the largest force: what a tool's nodes may pull with


def tool_shares(
    opposite: csr_matrix,
    rows: csr_matrix,
    areas: tuple[Array, Array],
    x: Array,
    y: Array,
    force: Array,
    known: Array,
) -> csr_matrix | None:
    """(m, n) parts r of the pairs' forces that the tool's nodes bear; None: nothing presses, or
    beside the tool, where no weights of one sign keep the moment.

    Args:
        opposite: (m, n) shape functions of the pairs at the tool's nodes.
        rows: (n, m) of the pairs.
        areas: (n,) of the pairs and (m,) of the tool's nodes, of what both surfaces cover [area].
        x, y: (n, gdim), (m, gdim) where pairs and nodes are [length].
        force: (n, gdim) of the pairs [force].
        known: (m, gdim) the same at the nodes, as rows say, whose moment is right.
    """
    w, size = _weights(opposite, rows, areas), np.linalg.norm(force, axis=1)
    borne = size > 0.0
    if not borne.any():
        return None
    w = (w @ diags(borne.astype(float))).tocoo()
    w.eliminate_zeros()
    node, pair = w.row, w.col
    x, y = x - y.mean(axis=0), y - y.mean(axis=0)
    scale = size.sum() * np.ptp(np.concatenate([x[pair], y]), axis=0).max()
    m, part = moments(y[node] - x[pair], force[pair]) / scale, size / size.sum()
    beside = (moments(x, force).sum(axis=0) - moments(y, known).sum(axis=0)) / scale
    alpha = np.zeros(m.shape[1])
    r, value = _tilted(w.data, pair, m, part, alpha)
    for _ in range(TILTS):  # of a convex function, whose slope is the moment that is missing
        slope = r @ m + beside
        if np.abs(slope).max() <= MOMENT_KEPT:
            return csr_matrix((r, (node, pair)), w.shape)
        mean = np.column_stack([np.bincount(pair, r * a, len(x)) for a in m.T])[pair]
        curvature = np.einsum("e,ei,ej->ij", r / part[pair], m - mean, m - mean)
        change = -np.linalg.pinv(curvature, NO_CURVATURE, hermitian=True) @ slope
        for cut in 0.5 ** np.arange(HALVES):
            now, then = _tilted(w.data, pair, m, part, alpha + cut * change)
            then += float((alpha + cut * change) @ beside)
            if then <= value + PROMISED * cut * (slope @ change) + VALUE_ROUNDED:
                break
        else:
            break
        alpha, r, value = alpha + cut * change, now, then
    return None


def check_beside(
    name: str, surfaces: Sequence[str], pressing: Sequence[Array], prescribed: int
) -> None:
    """Require that no node of a tool pulls where no pair of the other side does.

    Args:
        name: of the interface.
        surfaces: names of both sides.
        pressing: of both sides (n_i,) forces of pairs [force].
        prescribed: the tool's side.

    Raises:
        ContactError: one does; the same on every rank that gives the same forces.
    """
    largest = max(np.abs(pressing[1 - prescribed]).max(initial=0.0), 1e-300)
    pull, own = (-pressing[k].min(initial=0.0) / largest for k in (prescribed, 1 - prescribed))
    if pull > TOOL_PULLS >= own:
        raise ContactError(
            f"interface {name}: what presses lies beside {surfaces[prescribed]}, at whose nodes "
            f"forces pull by up to {pull:.1%} of the largest: facets of {surfaces[1 - prescribed]} "
            "are too large for a tool of its size. Refine them where it touches, or take a rigid "
            "obstacle"
        )


def _tilted(w: Array, pair: Array, m: Array, part: Array, alpha: Array) -> tuple[Array, float]:
    """Weights r (e,) of entries w (e,) of pairs, and sum_p |F_p| log Z_p over all force.

    Args:
        pair: (e,) whose they are.
        m: (e, k) moments, over those of all force.
        part: (n,) that pairs have in all force.
        alpha: (k,).
    """
    power, most = m @ alpha / part[pair], np.full(len(part), -np.inf)
    np.maximum.at(most, pair, power)
    r = w * np.exp(power - most[pair])
    Z, borne = np.bincount(pair, r, len(part)), part > 0.0
    return r / Z[pair], float(part[borne] @ (np.log(Z[borne]) + most[borne]))


def _weights(opposite: csr_matrix, rows: csr_matrix, areas: tuple[Array, Array]) -> csr_matrix:
    """(m, n) in proportion to areas and shape functions, by which areas (n,) of pairs are shared by
    nodes (m,) so that theirs come out, as nearly as that goes; where nodes opposite of a pair have
    none, those of its row. Sums are 1 per pair."""
    own, theirs = (np.where(a > SHARE_ROUNDED * a.max(), a, 0.0) for a in areas)
    shapes, rows = (N.multiply(N > SHARE_ROUNDED) for N in (opposite, rows))
    w = diags(theirs) @ shapes + THINLY * (diags(own) @ rows).T
    for _ in range(SHARINGS):  # iterative proportional fitting
        w = diags(_over(theirs, w.sum(axis=1))) @ w
        arrives = w.sum(axis=0)
        if np.abs(arrives - own).max() <= AREA_MISSED * theirs.sum():
            break
        w = w @ diags(_over(own, arrives))
    untold = np.asarray(w.sum(axis=0)).ravel() <= SHARE_ROUNDED * own
    w = w @ diags(1.0 - untold) + rows.T @ diags(1.0 * untold)
    return (w @ diags(_over(np.ones(len(own)), w.sum(axis=0)))).tocsr()


def _over(value: Array, sums: Array) -> Array:
    """(n,) values over sums, 0 where there are none."""
    return per_area(value[:, None], np.asarray(sums).ravel())[:, 0]
