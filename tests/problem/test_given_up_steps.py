"""Load steps of linear bodies that fail or are stopped on the way: all is as if they had not been
tried, or, where what has been found is to be kept, as if nothing had been raised."""

import numpy as np
import pytest
from slider import Slider

import dolfinx_llm as llm
from dolfinx_llm.forms.condensed.steps import CondensedForm
from dolfinx_llm.forms.flexibility import Flexibility


class Stop(Exception):
    """No error of the package."""


class Rough(llm.Law):
    """Friction like a layer of springs, which may break down."""

    slips, c, fails = True, 10.0, np.inf

    def rows(self, nodes):
        self.fails -= 1
        if self.fails < 0:
            raise Stop("broken down")
        return llm.laws.rows.LawRows.springs(
            nodes, -self.c * nodes.jump, np.full_like(nodes.jump, -self.c)
        )


def pressed(law=None):
    slider = Slider(law or llm.Coulomb(0.3))
    slider.move(0.0)
    return slider


def state(problem):
    common, local = problem.state_arrays()
    return common | local


def same(one, other, size=1.0):
    """Whether two states differ by rounding alone."""
    assert one.keys() == other.keys()
    for name, value in one.items():
        if value.dtype.kind in "iub":
            assert np.array_equal(value, other[name]), name
        elif value.dtype.kind == "f":
            np.testing.assert_allclose(
                value, other[name], rtol=0.0, atol=1e-12 * size, err_msg=name
            )


def stopped_after(problem, parts, error, where):
    """Have the iteration end in an error once some parts of a step have been accepted, also in the
    form that goes on where contact comes to no rest."""
    iteration, patch, count = problem.method.iteration, pytest.MonkeyPatch(), [0]
    accept = iteration.accept

    def counted(*given):
        accept(*given)
        count[0] += 1

    def failing(of):
        def call(*given):
            if count[0] >= parts:
                raise error("stopped")
            return of(*given)

        return call

    patch.setattr(iteration, "accept", counted)
    for form in (Flexibility, CondensedForm):
        patch.setattr(form, where, failing(getattr(form, where)))
    return patch.undo


@pytest.mark.parametrize("error", [KeyboardInterrupt, Stop, llm.ContactError])
@pytest.mark.parametrize("where", ["solve", "displacement"])
def test_stopped_in_a_later_part(error, where):
    """Nothing is left of the parts before, in forces, slip, loads and results."""
    slider = pressed()
    problem, results = slider.problem, slider.problem.results
    before, u = state(problem), problem.u[0].x.array.copy()
    undo = stopped_after(problem, 2, error, where)
    with pytest.raises(error):
        slider.move(0.05, 0.01, 4)
    undo()
    assert problem.results is results and np.array_equal(problem.u[0].x.array, u)
    same(state(problem), before, 0.0)
    slider.move(0.002, 0.011)
    known = pressed()
    known.move(0.002, 0.011)
    same(state(problem), state(known.problem), 1e2)


@pytest.mark.parametrize("handed", [False, True])
def test_what_accepted_raises(handed):
    """With Functions in ``state`` the step is given up; without what has been found is kept."""
    slider, known = pressed(), pressed()
    problem, before, results = slider.problem, state(slider.problem), slider.problem.results

    def accepted(given):
        assert given.results is not results
        raise Stop("too much")

    memory = {"state": [slider.top.copy()]} if handed else {}
    with pytest.raises(Stop):
        slider.move(0.05, 0.01, accepted=accepted, **memory)
    known.move(0.05)
    assert (problem.results is results) == handed
    same(state(problem), before if handed else state(known.problem), 0.0 if handed else 1e2)
    assert len(problem.u) == 2


def test_what_is_found_wrong_once_a_step_is_over(monkeypatch):
    """Results that cannot be made are no reason to go on from a step that nobody has seen."""
    slider = pressed()
    before = state(slider.problem)

    def fails(*_):
        raise Stop("no results")

    with monkeypatch.context() as patch:
        patch.setattr("dolfinx_llm.problem.problem.collect_results", fails)
        with pytest.raises(Stop):
            slider.move(0.05)
    same(state(slider.problem), before, 0.0)


def test_a_law_that_breaks_down():
    """An error in a user's law in the middle of a step."""
    slider, known = pressed(Rough()), pressed(Rough())
    before = state(slider.problem)
    slider.law.fails = 5
    with pytest.raises(Exception, match="broken down"):
        slider.move(0.05, 0.01, 4)
    slider.law.fails = np.inf
    same(state(slider.problem), before, 0.0)
    slider.move(0.02)
    known.move(0.02)
    same(state(slider.problem), state(known.problem), 1e2)
