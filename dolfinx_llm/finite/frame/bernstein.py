"""Bernstein's functions on [0, 1] of any degree d: those of control values of a segment, and their
products with a thickness that is linear along it, which are such functions of degree d + 1.

Their order is that of an element's nodes: those of both ends, then the others. They are at least 0
and add up to 1; over the whole segment each has the integral 1 / (d + 1).
"""

from __future__ import annotations

from math import comb

import numpy as np

from dolfinx_llm.base.arrays import Array


def _order(degree: int) -> list[int]:
    """Powers of xi in the functions."""
    return [0, degree, *range(1, degree)]


def values(degree: int, xi: Array) -> Array:
    """(n, degree + 1) at xi (n,).

    >>> values(2, np.array([0.0, 0.5])).tolist()
    [[1.0, 0.0, 0.0], [0.25, 0.25, 0.5]]
    """
    of = [comb(degree, i) * xi**i * (1.0 - xi) ** (degree - i) for i in _order(degree)]
    return np.column_stack(of)


def integrals(degree: int, xi: Array) -> Array:
    """(n, degree + 1) from 0 to xi (n,): sums of the functions of the next degree.

    >>> integrals(1, np.array([1.0])).tolist()
    [[0.5, 0.5]]
    """
    d = degree + 1
    higher = [comb(d, j) * xi**j * (1.0 - xi) ** (d - j) for j in range(d + 1)]
    return np.column_stack([sum(higher[i + 1 :]) for i in _order(degree)]) / d


def with_linear(degree: int, ends: Array) -> Array:
    """(f, degree + 1, degree + 2) products of the functions with linear ones with values (f, 2) at
    the ends, by functions of the next degree.

    >>> with_linear(1, np.array([[1.0, 3.0]])).tolist()
    [[[1.0, 0.0, 1.5], [0.0, 3.0, 0.5]]]
    """
    higher = _order(degree + 1)
    found = np.zeros((len(ends), degree + 1, degree + 2))
    for row, i in enumerate(_order(degree)):
        for k in (0, 1):
            factor = comb(degree, i) / comb(degree + 1, i + k)
            found[:, row, higher.index(i + k)] += factor * ends[:, k]
    return found
