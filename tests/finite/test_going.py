"""When iterations of an increment have come as far as they can."""

import pytest

from dolfinx_llm.finite.failures import Going

pytestmark = pytest.mark.quick


def test_residual_of_rounding():
    """Low for six iterations on end without a change: tips of teeth on others stayed at 1e-10."""
    going = Going()
    for error in (3e-1, 7e-7, 7e-11, 8e-11, 4e-11, 6e-11, 1e-10):
        assert not going.stopped(1.0, 0, error) and going.noise == 0.0
    going.stopped(1.0, 0, 7e-11)
    assert going.noise == 1e-9
    going.stopped(1.0, 1, 7e-11)
    assert going.noise == 0.0


def test_iterates_that_come_back():
    """They are met halfway; those that stay are not."""
    going = Going()
    for error in (1e-3, 2e-3, 1e-3, 2e-3):
        going.stopped(1.0, 0, error)
    assert going.part == 0.5
    for error in (1e-3, 1e-3, 1e-3, 1e-3):
        going.stopped(1.0, 0, error)
    assert going.part == 1.0


def test_laws_that_stay_missed_by_little():
    """No less than after the last iteration, or little for the third time and hardly less: what the
    solves between go along, where forces at supports of both sides are not unique, is chance."""
    for rests in ([1e-3, 2e-9, 1.9e-9], [2e-9, 1e-4, 1e-9, 3e-4, 4e-10]):
        going = Going()
        assert [going.lingers(rest) for rest in rests] == [False] * (len(rests) - 1) + [True]
    going = Going()
    for rest in (1e-3, 2e-3, 2e-9, 1e-5, 1e-9, 1e-5, 1e-11):  # of the first it is worth going on
        assert not going.lingers(rest)
