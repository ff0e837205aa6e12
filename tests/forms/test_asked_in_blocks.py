"""Pairs that a factorised step of the condensed form is asked for, many at once."""

from functools import partial

import hertz2d
import numpy as np
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm.forms.condensed.friction import FrictionStep


def test_friction(monkeypatch):
    """The same as one by one, by one solve for all. On a plane: of two cylinders, which hardly
    anything holds sideways, processors round the answers by up to 2e-5 of the largest."""
    asked, blocks = FrictionStep.ask, []

    def both(step, loads, many=FrictionStep.ask_many):
        found = many(step, loads)
        blocks.append((len(loads), [asked(step, *load) for load in loads], found))
        return found

    monkeypatch.setattr(FrictionStep, "ask_many", both)
    monkeypatch.setattr(llm, "Frictionless", partial(llm.Coulomb, 0.3))  # of the scene
    options = {"solver": "condensed", "petsc_options": {"pc_type": "lu"}}
    problem = hertz2d.problem("plane", (16, 16), comm=MPI.COMM_SELF, **options)
    problem.solve()
    assert max(count for count, *_ in blocks) > 4
    for _, singly, found in blocks:
        for one, other in zip(singly, found, strict=True):
            for a, b in zip(one, other, strict=True):
                np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-9 * np.abs(a).max())
