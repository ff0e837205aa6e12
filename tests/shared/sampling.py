"""Some of a product of parameters in the place of all; the others are for ``make long``."""

import itertools

import numpy as np
import pytest


def covering(*factors, fits=lambda *row: True, seed=2001):
    """Rows of a product, as few as are easily found, in which every level of a factor meets every
    level of every other one; which rows these are is drawn at random, always in the same way.

    Args:
        factors: sequences of levels.
        fits: whether a row can be; pairs of levels in no row that can be are left out.
        seed: of the draw.

    Returns:
        List of tuples, one level of each factor.
    """
    rows = itertools.product(*map(enumerate, factors))
    rows = [row for row in rows if fits(*(level for _, level in row))]
    np.random.default_rng(seed).shuffle(rows)
    pairs = [
        set(itertools.combinations([(k, i) for k, (i, _) in enumerate(row)], 2)) for row in rows
    ]
    left, found = set().union(*pairs), []
    while left:
        best = max(range(len(rows)), key=lambda k: len(pairs[k] & left))
        left -= pairs[best]
        found.append(tuple(level for _, level in rows[best]))
    return found


def longer(*values):
    """Parameters of a test for ``make long`` alone."""
    return pytest.param(*values, marks=pytest.mark.long)


def some_of(rows, kept):
    """All rows as parameters of a test; those that are not kept run in ``make long`` alone."""
    rows = [(row if isinstance(row, tuple) else (row,), row in kept) for row in rows]
    return [pytest.param(*row) if stays else longer(*row) for row, stays in rows]


def drawn(*factors, every=1, **options):
    """The whole product as parameters; in every run those that are ``covering``, or a part."""
    fits = options.get("fits", lambda *row: True)
    rows = [row for row in itertools.product(*factors) if fits(*row)]
    return some_of(rows, covering(*factors, **options)[::every])
