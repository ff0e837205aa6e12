"""What a solve returns is the user's: writing to it changes nothing of the problem."""

from dataclasses import fields

import numpy as np
import pytest
from sampling import drawn
from slider import Slider

import dolfinx_llm as llm


def arrays(one):
    """All arrays of a result, of its frame and sides."""
    found = {}
    for field in fields(one):
        value = getattr(one, field.name)
        if isinstance(value, np.ndarray):
            found[field.name] = value
    for k, side in enumerate(getattr(one, "sides", ())):
        found |= {f"{k} {name}": value for name, value in arrays(side).items()}
    if getattr(one, "frame", None) is not None:
        found |= {"frame.x": one.frame.x, "frame.v": one.frame.v, "frame.cells": one.frame.cells}
    return found


LAWS = llm.Coulomb(0.3), llm.Frictionless(), llm.Tied()


@pytest.mark.parametrize(
    ("law", "finite", "rigid"), drawn(LAWS, (False, True), (False, True)), ids=str
)
def test_results_that_are_written_to(law, finite, rigid):
    told = []
    for spoil in (False, True):
        slider = Slider(law, finite, rigid)
        slider.move(0.0)
        for value in arrays(slider.problem.results[0]).values():
            if spoil:
                value[:] = 0
        for u in slider.problem.u:
            u.x.array[:] *= 1.0 if finite else 7.0  # at finite deformation the user's to begin with
        slider.move(0.004, 0.011)
        told.append(arrays(slider.problem.results[0]))
    for name, value in told[0].items():
        np.testing.assert_array_equal(told[1][name], value, err_msg=name)
