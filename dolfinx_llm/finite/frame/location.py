"""Nodes of one surface on the moving frame, found along its averaged normals.

Node p at x meets the frame at y(xi) where x = sum_J N_J(xi) y_J + g n, with n the direction of
sum_J N_J(xi) n_J and n_J averaged normals of the frame's nodes: continuous over its edges. Of a
surface that meets itself it is that of sum_J N_J(xi) n_J - n_p, since both sides are alike there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, per_item
from dolfinx_llm.finite.frame.jacobians import NodalNormals, coordinates, jacobian
from dolfinx_llm.geometry.cells import (
    CORNERS,
    cell_sizes,
    connected,
    joined_lists,
    repeated_for,
    shape_functions,
)
from dolfinx_llm.geometry.element import element_of

TRIED = {2: 6, 3: 12}  # facets next to a node that it may meet
AROUND = 1.5  # radii of the largest facet, within which all are tried for the rest
MET = 1e-10  # distance over facet size that is left where a node has met a facet
AS_HIGH = 1e-6  # of a facet: difference of heights that is none
# Shape functions above minus this: within a facet. A node that comes to rest on the edge of two is
# on the same one in each iteration: derivatives differ, and Newton's would go to and fro.
INSIDE = 1e-6
MISSED = 1e3  # reference coordinates of what does not meet a facet
FOCUS = 1e-9  # of a facet's size to the power of d: what is left where normals run together
VAGUE = 0.1  # length of the mean of unit normals below which a facet's nodes tell no direction
OPPOSITE = 1.4  # the same of n_J - n_p, where normals differ by 90 degrees
BEHIND_IT = 0.5  # of a facet: what lies deeper behind one does not meet it, if it meets another
ITERATIONS_TO_MEET = 15
SETTLED = 1e-9  # last change of Newton's iteration: its square is rounding


@dataclass(frozen=True, eq=False)
class OnFrame:
    """Where n nodes lie on a frame of facets with k nodes, d = gdim - 1."""

    facet: Array  # (n,) facet of the frame
    xi: Array  # (n, d) reference coordinates; beyond the rim those of the continued facet
    N: Array  # (n, k) shape functions
    dN: Array  # (n, k, d) their derivatives
    height: Array  # (n,) of the node over the frame, in units of the mean normal's length
    mean: Array  # (n, gdim) sum_J N_J n_J
    met: Array  # (n,) whether it meets the frame at all
    beyond: Array  # (n,) how far it lies beyond the facet: minus the smallest shape function
    # of its corners

    @property
    def normal(self) -> Array:
        """(n, gdim) the frame's unit normal there."""
        return self.mean / np.linalg.norm(self.mean, axis=1)[:, None]

    @property
    def gap(self) -> Array:
        """(n,) distance of the node from the frame along its normal [length]."""
        return self.height * np.linalg.norm(self.mean, axis=1)

    def part(self, which: Array) -> OnFrame:
        """Some of the nodes (k,)."""
        fields = {name: getattr(self, name)[which] for name in self.__dataclass_fields__}
        return OnFrame(**fields)


def find_on_frame(
    x: Array,
    y: Array,
    facets: Array,
    normals: Array,
    own: Array | None = None,
) -> OnFrame:
    """Where nodes meet a frame: within a facet, the nearest of these; else beyond the nearest. One
    beyond the end of a part of the frame does not meet another part farther away, as of a stack.

    Args:
        x: (n, gdim) nodes [length].
        y: (m, gdim) the frame's nodes [length].
        facets: (f, k) its facets.
        normals: (m, gdim) of its nodes.
        own: (n, gdim) normals of the nodes, where both are of one surface.
    """
    n, gdim = x.shape
    p, tried = y[facets], min(TRIED[gdim], len(facets))
    tree = cKDTree(p.mean(axis=1))
    near = tree.query(x, k=tried)[1].reshape(n, tried)
    part = connected(facets, len(y))[0]
    found, away = _nearest(
        x, y, facets, part, (normals, own), np.repeat(np.arange(n), tried), near.ravel()
    )
    rest = np.flatnonzero(away > 0.0)  # beyond all of them: over a long facet, or over none
    if len(rest) and tried < len(facets):
        radius = np.linalg.norm(p - p.mean(axis=1)[:, None], axis=2).max()
        around = tree.query_ball_point(x[rest], AROUND * radius)
        which = np.concatenate([np.arange(len(rest)), repeated_for(np.arange(len(rest)), around)])
        facet = np.concatenate([found.facet[rest], joined_lists(around)])
        of = normals, None if own is None else own[rest]
        again, _ = _nearest(x[rest], y, facets, part, of, which, facet)
        fields = {name: np.array(getattr(found, name)) for name in found.__dataclass_fields__}
        for name, value in fields.items():
            value[rest] = getattr(again, name)
        return OnFrame(**fields)
    return found


def _nearest(
    x: Array,
    y: Array,
    facets: Array,
    part: Array,
    normals: tuple[Array, Array | None],
    which: Array,
    facet: Array,
) -> tuple[OnFrame, Array]:
    """The best of the facets (k,) that are tried for nodes ``which`` (k,), each at least once, and
    how far (n,) nodes lie beyond it [length]."""
    p, n = y[facets[facet]], normals[0][facets[facet]]
    own = None if normals[1] is None else normals[1][which]
    n = n if own is None else n - own[:, None]
    xi, height, met = _meet(x[which], p, n, VAGUE if own is None else OPPOSITE)
    N, foot = shape_functions(facets.shape[1], xi)[0], _of_corners(facets.shape[1], xi)
    within = np.where(foot > INSIDE, foot, 0.0)
    within /= within.sum(axis=1)[:, None]
    if N.shape != foot.shape:  # second order
        within = shape_functions(facets.shape[1], within @ CORNERS[foot.shape[1]])[0]
    away = np.linalg.norm(_sums(N - within, p), axis=1)
    away = np.where(met, np.where(foot.min(axis=1) < -INSIDE, away, 0.0), np.inf)
    alike = AS_HIGH * np.ptp(p, axis=1).max(initial=0.0)  # or rounding would choose at a frame node
    level = np.round(np.abs(height) / (alike or 1.0))
    order = np.lexsort((facet, level, away, which))
    best = order[np.unique(which[order], return_index=True)[1]]
    if own is None:
        high = height * np.linalg.norm(_sums(N, n), axis=1)
        best = _on_the_same_part(best, which, part[facet], away, high)
    else:  # the other face of its own wall may be nearer than what a node faces
        deep = (
            height * np.linalg.norm(_sums(N, n), axis=1) < -BEHIND_IT * cell_sizes(y, facets)[facet]
        )
        order = np.lexsort((facet, level, away, deep | ~met, which))
        best = order[np.unique(which[order], return_index=True)[1]]
    mean = _sums(N, n if own is None else n + own[:, None] * ~met[:, None, None])[best]
    N, dN = shape_functions(facets.shape[1], xi[best])
    beyond = -foot[best].min(axis=1)
    found = OnFrame(facet[best], xi[best], N, dN, height[best], mean, met[best], beyond)
    return found, away[best]


def _on_the_same_part(best: Array, which: Array, part: Array, away: Array, high: Array) -> Array:
    """(n,) the best (n,) of what is tried (k,), or the nearest in space where that is of another
    part of the frame: nodes beyond its end are those of facets that it covers in part."""
    if not part.any():
        return best
    space = np.where(np.isfinite(away), np.hypot(away, high), np.inf)
    order = np.lexsort((space, which))
    nearest = order[np.unique(which[order], return_index=True)[1]]
    nearer = space[nearest] < np.abs(high[best])
    return np.where((part[best] != part[nearest]) & nearer, nearest, best)


def _of_corners(k: int, xi: Array) -> Array:
    """(n, c) shape functions of the corners of cells with k nodes, as if there were no others."""
    d = xi.shape[1]
    return element_of(d, element_of(d, k).corners).shape(xi)[0]


def _meet(x: Array, y: Array, n: Array, vague: float) -> tuple[Array, Array, Array]:
    """Reference coordinates, heights and success of Newton's iteration for points x (n, gdim) on
    facets with nodes y and normals n (n, k, gdim), the mean of which is longer than ``vague``."""
    k, d = y.shape[1], x.shape[1] - 1
    xi = np.full((len(x), d), {2: 0.5, 3: 1.0 / 3.0, 4: 0.0}[element_of(d, k).corners])
    height = np.zeros(len(x))
    at = np.arange(len(x))  # what has neither arrived nor left
    with np.errstate(all="ignore"):
        for _ in range(ITERATIONS_TO_MEET):
            N, dN = shape_functions(k, xi[at])
            raised = y[at] + height[at][:, None, None] * n[at]
            step = _solve(_tangent(raised, n[at], N, dN), x[at] - _sums(N, raised))
            xi[at] += step[:, :-1]
            height[at] += step[:, -1]
            going = np.abs(step).max(axis=1, initial=0.0) > SETTLED  # not so where it is NaN
            at = at[going & (np.abs(xi[at]).max(axis=1) < MISSED)]
            if not len(at):
                break
        N, dN = shape_functions(k, xi)
        raised = y + height[:, None, None] * n
        size = np.linalg.norm(y - y.mean(axis=1)[:, None], axis=2).max(axis=1)
        met = np.linalg.norm(x - _sums(N, raised), axis=1) < MET * size
        met &= np.abs(np.linalg.det(_tangent(raised, n, N, dN))) > FOCUS * size**d
        met &= np.linalg.norm(_sums(N, n), axis=1) > vague
    xi[~met], height[~met] = 0.0, 0.0
    return xi, height, met


def _sums(N: Array, y: Array) -> Array:
    """(n, gdim) sums over nodes: weights N (n, k), values y (n, k, gdim)."""
    return np.einsum("nk,nki->ni", N, y)


def _tangent(raised: Array, n: Array, N: Array, dN: Array) -> Array:
    """(n, gdim, gdim) derivative by (xi, height) of the point over the frame, whose nodes raised by
    that height along their normals n lie at ``raised`` (n, k, gdim)."""
    along = np.swapaxes(raised, 1, 2) @ dN
    return np.concatenate([along, _sums(N, n)[:, :, None]], axis=2)


def _solve(A: Array, b: Array) -> Array:
    """(n, d) solutions of small systems; NaN where they are singular."""
    singular = ~(np.abs(np.linalg.det(A)) > 1e-300)
    A = np.where(singular[:, None, None], np.eye(A.shape[1]), A)
    x = np.linalg.solve(A, b[:, :, None])[:, :, 0]
    x[singular] = np.nan
    return x


@dataclass(frozen=True, eq=False)
class LocationDerivatives:
    """Derivatives of a location by the coordinates of all nodes of the interface."""

    xi: csr_matrix  # (n d, width)
    normal: csr_matrix  # (n gdim, width)

    def part(self, which: Array, gdim: int) -> LocationDerivatives:
        """Those of some of the nodes (k,)."""
        xi = (which[:, None] * (gdim - 1) + np.arange(gdim - 1)).ravel()
        normal = (which[:, None] * gdim + np.arange(gdim)).ravel()
        return LocationDerivatives(self.xi[xi], self.normal[normal])


def location_derivatives(
    at: OnFrame,
    y: Array,
    facets: Array,
    normals: NodalNormals,
    columns: tuple[Array, int],
    width: int,
    itself: NodalNormals | None,
) -> LocationDerivatives:
    """How places and normals change with x, y and, through these, the nodal normals.

    With T = [y' + g n', n] the derivative of the point over the frame: d(xi, g) = T⁻¹ (dx -
    sum_J N_J dy_J - g sum_J N_J dn_J), n not normalised; dn of the unit normal is what is left of
    sum_J (N_J dn_J + n_J dN_J) perpendicular to n.

    Args:
        at: the n nodes' places.
        y, facets, normals: of the frame.
        columns: (n, gdim) numbers of the coordinates of the nodes x; number of the frame's first.
        width: number of all coordinates.
        itself: normals of the nodes x, where both are of one surface.
    """
    cells = facets[at.facet]
    gdim, nn = y.shape[1], normals.n[cells]
    if itself is not None:
        nn = nn - (itself.n * at.met[:, None])[:, None]
    raised = y[cells] + at.height[:, None, None] * nn
    inverse = np.linalg.inv(_tangent(raised, nn, at.N, at.dN))
    n, k = at.N.shape
    unit = np.eye(gdim)
    weights = (at.N[:, None, :, None] * unit[:, None, :]).reshape(n, gdim, k * gdim)
    own = np.concatenate([np.broadcast_to(unit, (n, gdim, gdim)), -weights], axis=2)
    places = np.concatenate([columns[0], coordinates(cells, gdim, columns[1])], axis=1)
    mean = jacobian(weights, coordinates(cells, gdim), y.size) @ normals.derivative  # N_J dn_J
    if itself is not None:
        mean = mean - diagonal(np.repeat(at.met, gdim)) @ itself.derivative
    point = jacobian(own, places, width) - per_item(at.height[:, None, None] * unit) @ mean
    xi = per_item(inverse[:, :-1]) @ point
    direction = np.einsum("nkd,nki->nid", at.dN, nn)
    length = np.linalg.norm(at.mean, axis=1)
    normal = at.normal
    project = (unit - normal[:, :, None] * normal[:, None, :]) / length[:, None, None]
    turn = per_item(project) @ (mean + per_item(direction) @ xi)
    return LocationDerivatives(xi, turn)
