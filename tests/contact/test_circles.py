"""Iterates of a load step that come back are told by their residuals."""

import pytest

from dolfinx_llm.contact.search.circles import Circles


@pytest.mark.parametrize("n", range(2, 7))
def test_circles_of_so_many_iterations(n):
    """Friction has the bound of the last iterate once a circle has closed, and not before."""
    history = [{"residual": 0.5}]
    circles, lags = Circles(history), []
    for i in range(2 * n):
        history.append({"residual": 0.1 * (1 + i % n)})
        lags.append(circles.lag(restless=True))
    assert lags == [False] * (2 * n - 1) + [True]


def test_what_falls_is_no_circle():
    """Residuals that fall by a part each, and contact that has come to rest."""
    history = []
    circles = Circles(history)
    for i in range(20):
        history.append({"residual": 0.9**i})
        assert not circles.lag(restless=True)
    history += [{"residual": 0.1}] * 4
    assert not circles.lag(restless=False)
