"""What is changed between two solves counts in the second, and nothing else is made anew."""

import changed
import numpy as np
import pytest
from conftest import run_mpi_json
from mpi4py import MPI
from sampling import longer, some_of
from slider import Slider

import dolfinx_llm as llm
from dolfinx_llm.base import compat
from dolfinx_llm.forms import direct

COMM = MPI.COMM_WORLD


def assert_followed(found, cases):
    assert len(found) == sum(map(len, cases))
    for name, (error, moved) in found.items():
        assert error <= 1e-10, name
        assert moved > 1e-3, name  # it does change something


@pytest.mark.parametrize(("law", "form"), changed.cases(1))
def test_like_a_problem_made_afterwards(law, form):
    """Every change with every law and every form, one after the other on the same problem."""
    changes = changed.cases(1)[law, form]
    assert_followed(changed.compare(COMM, law, form, changes), [changes])


@pytest.mark.parametrize("part", [2, *map(longer, (0, 1, 3, 4, 5, 6, 7))])
def test_like_a_problem_made_afterwards_on_two_ranks(part):
    assert_followed(run_mpi_json("changed.py", 2, part), changed.cases(2, part).values())


@pytest.fixture
def counts(monkeypatch):
    """How often forms are compiled, K is assembled, and matrices are factorised."""
    made = {"compiled": 0, "assembled": 0, "factorised": 0}

    def counted(owner, name, key):
        original = getattr(owner, name)

        def call(*args, **kwargs):
            made[key] += 1
            return original(*args, **kwargs)

        monkeypatch.setattr(owner, name, call)

    counted(compat, "form", "compiled")
    counted(compat, "assemble_matrix", "assembled")
    counted(direct.DirectSolver, "_factorise", "factorised")
    return made


@pytest.mark.parametrize(("law", "form"), [("tied", "saddle"), ("friction", "flexibility")])
def test_what_did_not_change_stays(counts, law, form):
    data = changed.Data(COMM)
    problem = data.problem(law, form)
    problem.solve()
    first, operators = dict(counts), problem.operators
    assert first == {"compiled": 2, "assembled": 1, "factorised": 1}
    for change in (changed.function, changed.values, lambda data: None):
        change(data)
        data.force.value *= 1.1
        problem.solve()
    assert counts == first
    data.E.value = 1.0  # as it is
    problem.solve()
    assert counts == first
    changed.time_step(data)
    problem.solve()
    assert counts == {"compiled": 2, "assembled": 2, "factorised": 2}
    assert problem.operators is operators
    changed.mesh(data)
    problem.solve()
    assert counts == {"compiled": 2, "assembled": 3, "factorised": 3}
    assert problem.operators is not operators


def dragged(form, drags):
    """Pressed and dragged to and fro; what has slipped stays in the forces."""
    data = changed.Data(COMM)
    data.step.value, data.force.value = 1e6, np.zeros(3)
    problem = data.problem("friction", form)
    for drag in drags:
        data.move(drag, -0.02)
        problem.solve()
    return data, problem


def outcome(problem):
    return problem.u.x.array.copy(), problem.results[0].sides[0].force.copy()


@pytest.mark.parametrize("form", some_of(changed.FORMS, changed.FORMS[2:]))
def test_slip_is_kept(form):
    """Under prescribed motion twice the modulus doubles the forces, wherever bodies go from there,
    with all that has slipped before."""
    data, problem = dragged(form, (0.0, 0.06, 0.01))
    data.move(0.0, -0.02)
    problem.solve()
    known, force = outcome(problem)
    data, problem = dragged(form, (0.0, 0.06, 0.01))
    data.E.value, data.step.value = 2.0, 0.5e6
    data.move(0.0, -0.02)
    problem.solve()
    found, double = outcome(problem)
    size = np.abs(known).max()
    assert np.abs(found - known).max() <= 1e-9 * size
    assert np.abs(double - 2.0 * force).max() <= 1e-9 * np.abs(force).max()
    problem.reset()  # from rest there is another way to the same place
    problem.solve()
    assert np.abs(outcome(problem)[0] - known).max() > 1e-3 * size


@pytest.mark.parametrize("form", some_of(changed.FORMS, changed.FORMS[:1]))
def test_increments_begin_where_the_last_step_ended(form):
    """Held as they were, with twice the modulus and in parts, bodies that stick do not move."""
    data, problem = dragged(form, (0.0, 0.002))
    known, force = outcome(problem)
    data.E.value, data.step.value = 2.0, 0.5e6
    problem.solve(increments=3)
    found, double = outcome(problem)
    assert not any(entry["slip"] for entry in problem.history)
    assert np.abs(found - known).max() <= 1e-9 * np.abs(known).max()
    assert np.abs(double - 2.0 * force).max() <= 1e-9 * np.abs(force).max()


def test_after_a_change_that_cannot_be_solved():
    """The state of contact outlives data that were refused."""
    data, problem = dragged("flexibility", (0.0, 0.06, 0.01))
    data.move(0.0, -0.02)
    problem.solve()
    known, _ = outcome(problem)
    data, problem = dragged("flexibility", (0.0, 0.06, 0.01))
    data.move(0.0, -0.02)
    data.E.value = np.nan
    with pytest.raises(llm.ContactError, match="NaN or infinite"):
        problem.solve()
    with pytest.raises(llm.ContactError, match="NaN or infinite"):
        problem.solve()
    data.E.value = 1.0
    assert np.abs(problem.solve().x.array - known).max() <= 1e-9 * np.abs(known).max()


def test_what_there_was_where_a_change_cannot_be_solved():
    """Matrices and forces of the last solve serve on; before one, and once forgotten, an error says
    that there are none. They were freed, and using them crashed."""
    slider = Slider(llm.Tied())
    problem = slider.problem
    with pytest.raises(llm.ContactError, match=r"call solve\(\) first"):
        problem.pushed  # noqa: B018
    slider.move(0.0)
    pushed, norms = problem.pushed, (problem.B.norm(), problem.L_b.norm())
    held = list(slider.bcs)
    del slider.bcs[:]
    with pytest.raises(llm.ContactError, match="rigid motion"):
        problem.solve()
    np.testing.assert_array_equal(problem.pushed, pushed)
    assert (problem.B.norm(), problem.L_b.norm()) == norms and str(problem)
    slider.bcs += held
    problem.solve()
    assert np.abs(problem.pushed - pushed).max() <= 1e-12 * np.abs(pushed).max()
    problem.reset()
    with pytest.raises(llm.ContactError, match=r"call solve\(\) first"):
        problem.pushed  # noqa: B018


def test_conditions_without_a_number_are_named():
    data = changed.Data(COMM)
    problem = data.problem("tied", "saddle")
    problem.solve()
    data.motion.x.array[:] = np.nan
    with pytest.raises(llm.ContactError, match="values of the Dirichlet conditions"):
        problem.solve()


def test_results_while_nothing_is_known():
    """Before the first load step, after ``reset``, and where a mesh was moved: an IndexError, and
    results of what had been forgotten."""
    data = changed.Data(COMM)
    problem = data.problem("friction", "saddle")
    for forget in (lambda: None, problem.reset, lambda: (changed.mesh(data), problem.update())):
        forget()
        with pytest.raises(llm.ContactError, match="no results yet: call solve"):
            problem.results[0]
        problem.solve()
        assert problem.results[0].pressure.max() > 0.0


def test_update_alone():
    """K is that of the data as they are, once asked to."""
    data = changed.Data(COMM)
    problem = data.problem("tied", "saddle")
    data.step.value = 1e9
    problem.update()
    before = problem.K.norm()
    problem.update()
    assert problem.K.norm() == before
    data.E.value = 4.0
    problem.update()
    free = problem.K.getDiagonal().array_r[~problem.bulk.dofs.fixed]
    data.E.value = 1.0
    problem.update()
    ratio = free / problem.K.getDiagonal().array_r[~problem.bulk.dofs.fixed]
    assert np.abs(ratio - 4.0).max() <= 1e-6


def test_classical_forms_follow():
    """They factorise anew for another stiffness, and refuse another geometry."""
    data = changed.Data(COMM)
    problem = data.problem("tied", "saddle")
    ties = llm.classical.NodeToSegment(problem, slave=1)
    before = ties.solve().x.array.copy()
    changed.time_step(data)
    found = ties.solve().x.array
    known = llm.classical.NodeToSegment(data.problem("tied", "saddle"), slave=1).solve().x.array
    assert np.abs(found - known).max() <= 1e-10 * np.abs(known).max()
    assert np.abs(found - before).max() > 1e-3 * np.abs(known).max()
    changed.mesh(data)
    with pytest.raises(llm.ContactError, match="make it anew"):
        ties.solve()
