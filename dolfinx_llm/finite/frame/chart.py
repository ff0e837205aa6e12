"""Polynomials that rows of a moving frame reproduce: linear ones, at second order squares too.

Corrections of rows do not change them, and functions that are close to them by next to nothing. The
coordinate across a second-order frame that is drawn curved in the plane is one: on a circle of n
facets the others reproduce it to (pi / n)^4. It is therefore added to them. Else rounding in it
would be divided by the square of that number, and Newton's iteration would end at 1e-10, or not at
all. Where a frame's normals tell no direction across it, as around a closed tube, all coordinates
that they point along alike are added, at any order: else rounding would decide which is across.

Connected parts of a frame, as tops of a stack, have functions of their own: each bears a force and
a moment, and what corrections of one part cannot remove those of another do not.
"""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
from scipy.sparse import bmat, csr_matrix
from scipy.sparse.linalg import splu

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.geometry.cells import areas_around, connected, unit
from dolfinx_llm.geometry.element import Element
from dolfinx_llm.geometry.surface import Surface

Control = tuple[csr_matrix, csr_matrix]

LIFTED = 1e-3  # part of a coordinate across a frame that is none, over its length
UNDECIDED = 1.1  # ratio of what normals point along two coordinates, below which neither is across
EDGEWISE = 1e-2  # least over largest singular value of functions that are hardly independent
ELSEWHERE = 1e-9  # weight of nodes where nothing is covered then, over the largest
NOT_FAINT = 1e2  # times what is added to a diagonal, for what no row bears
REFINEMENTS = 2  # what M bears with 1000 times as much is exact to 1e-9
FUNCTION_YIELDS = 1e-9  # of a facet's area: how much the function across yields


def products(element: Element) -> list[tuple[int, int]]:
    """Of coordinates along a frame: the squares that its rows reproduce; none at first order."""
    if element.order == 1:
        return []
    return list(combinations_with_replacement(range(element.dim), 2))


def functions_of(element: Element) -> int:
    """How many functions ``chart`` gives."""
    return _along(element) + 1 + element.dim * (element.order > 1)


def _along(element: Element) -> int:
    """How many of them are functions of coordinates along the frame."""
    return 1 + element.dim + len(products(element))


def chart_of(frame: Surface, forces: Array) -> Array:
    """``chart`` of the parts of a surface as drawn, side by side; forces (m,) of unit pressure on
    what is covered [area]."""
    normals, part = unit(areas_around(frame.x, frame.skin)), connected(frame.cells, len(frame.x))[1]
    count = functions_of(frame.element)
    found = np.zeros((len(part), count * (part.max() + 1)))
    for k in range(part.max() + 1):
        own = part == k
        functions = chart(frame.x[own], normals[own], frame.element, forces[own])
        found[own, k * count : (k + 1) * count] = functions
    return found


def chart(Y: Array, normals: Array, element: Element, forces: Array) -> Array:
    """(m, c) functions on a frame as drawn: 1, coordinates along it, and at second order their
    products and the coordinate across; orthogonal. Where another coordinate is like that across,
    this is there at first order as well, its products at second. Those that others tell are 0.

    Along it is where its normals point least: not where its nodes spread most, which is the plane
    of its circle for a short closed tube, where x² + y² is constant, and rows reproduce z.

    Of a frame that folds, the part that is covered may be seen edgewise there: then the mean is
    that over this part.

    Args:
        Y: (m, gdim) nodes as drawn [length].
        normals: (m, gdim) of these, unit vectors.
        element: of the frame's facets.
        forces: (m,) of unit pressure on what is covered [area].
    """
    every = np.ones(len(Y))
    found = _functions(Y, normals, element, every)
    covered = np.maximum(forces, 0.0) / (forces.max(initial=0.0) or 1.0)
    there = found[covered > 0.0, : _along(element)]
    size = np.linalg.norm(there, axis=0)
    seen = np.linalg.svd(there / np.where(size > 0.0, size, 1.0), compute_uv=False)
    if len(there) and seen[-1] < EDGEWISE * seen[0]:
        return _functions(Y, normals, element, covered + ELSEWHERE)
    return found


def _functions(Y: Array, normals: Array, element: Element, weights: Array) -> Array:
    """The same, orthogonal in a weighted (m,) sense."""
    root = np.sqrt(weights / weights.sum())[:, None]
    centred = Y - (root**2 * Y).sum(axis=0)
    _, pointing, axes = np.linalg.svd(root * normals, full_matrices=False)
    s = centred @ axes[::-1].T  # the last is that across
    s /= np.linalg.norm(root * s, axis=0).max()
    s, across = s[:, :-1], s[:, -1]
    alike = pointing[0] < UNDECIDED * pointing[:0:-1]  # (d,) of the coordinates along
    # Around a tube x² + y² is constant: of their squares, x² - y² does not change with the axes.
    squares = [s[:, a] * s[:, b] - (a == b and alike[a]) * across**2 for a, b in products(element)]
    found = _orthogonal(root, np.column_stack([np.ones(len(Y)), s, *squares]))
    second, closed = element.order > 1, alike.any()
    others = [(second or closed) * across]
    others += [closed * s[:, a] * across for a in range(element.dim) if second]
    for other in others:
        for _ in range(2):  # once more for what rounding leaves
            other = other - found @ ((root**2 * found).T @ other)
        left = float(np.linalg.norm(root[:, 0] * other))
        found = np.column_stack([found, other / left if left > LIFTED else np.zeros(len(Y))])
    return found


def _orthogonal(root: Array, functions: Array) -> Array:
    """Functions (m, c), the first of which span the same, where weights have roots (m, 1)."""
    triangle = np.linalg.qr(root * functions)[1]
    return np.linalg.solve(triangle.T, functions.T).T


def borne(control: Control, pressures: Array, forces: Array, part: Array) -> Array:
    """(m, c) nodal forces of pressures with nodal values (m, c), where a unit pressure's are (m,).

    At second order control values are multiplied, E^T forces with C pressures. None of the first is
    negative: so no polynomial has forces that do no work on it, which those at nodes may cancel to
    where a frame is covered in part. Parts (m,) that nothing covers count as if all of them were.

    Args:
        control: E, C (m, m) of the frame, see ``finite.frame.sides``.
    """
    E, C = control
    covered = np.bincount(part, forces != 0.0) > 0.0
    own = np.where(covered[part], forces, 1.0)
    return np.asarray(C.T @ ((E.T @ own)[:, None] * (C @ pressures)))


def borne_by(control: Control, pressure: Array) -> csr_matrix:
    """(m, m) by which ``borne`` of one pressure (m,) follows from a unit pressure's forces."""
    E, C = control
    return C.T @ diagonal(C @ pressure) @ E.T


def yielding(element: Element, part: Array) -> Array:
    """(c,) how much functions of all parts (m,) yield over a facet's area: that across, which
    others may tell."""
    own = np.where(np.arange(functions_of(element)) < _along(element), 0.0, FUNCTION_YIELDS)
    return np.tile(own, part.max() + 1)


def bordered(M: csr_matrix, faint: float, G: Array, r: Array, soft: Array) -> tuple[Array, Array]:
    """mu and kappa of (M - faint) mu + G kappa = r, Gᵀ mu = soft kappa, but for parts of a frame
    that no row connects with others: their residuals have moments that nothing bears, as of places
    that bend, and press apart from each other. ``NOT_FAINT`` times ``faint`` does: with less mu is
    so large there that rounding tells the corrections. Refinements are without it.

    Args:
        M: (m, m) of ``finite.frame.design`` [area].
        faint: added to its diagonal [area].
        G: (m, c) what the chart's functions bear: see ``borne`` [area].
        r: (m,) residual [area].
        soft: (c,) how much functions yield [area].
    """
    c, added = G.shape[1], np.full(len(r), NOT_FAINT * faint)
    held = M + diagonal(added - faint)
    A = bmat([[held, csr_matrix(G)], [csr_matrix(G.T), diagonal(-soft)]], format="csc")
    b = np.concatenate([r, np.zeros(c)])
    try:
        factor = splu(A)
    except RuntimeError as error:  # SuperLU's "exactly singular"
        raise ContactError(
            "design of the moving frame: its rows cannot be balanced "
            f"(SuperLU: {error}). Check that the surfaces face each other"
        ) from None
    x = factor.solve(b)
    for _ in range(REFINEMENTS):
        left = b - A @ x
        left[: len(r)] += added * x[: len(r)]
        x += factor.solve(left)
    return x[: len(r)], x[len(r) :]
