"""Contact that comes to no rest in one form of the system: another one goes on."""

import numpy as np
import other_form
import pytest
import scenes
import wall_scenes as walls
from conftest import run_mpi_json
from dolfinx import fem
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm.contact.search.circles import UNSETTLED
from dolfinx_llm.forms.condensed.steps import CondensedForm
from dolfinx_llm.forms.flexibility import Flexibility

pytestmark = pytest.mark.quick


def dragged(law, solver, fails=lambda: None, comm=MPI.COMM_SELF, increments=1, **kwargs):
    """Problem of two blocks, pressed, and then dragged once ``fails()`` was called, and forces of
    both sides."""
    V, tags = scenes.two_blocks(comm)
    drag, down = fem.Constant(V.mesh, 0.0), fem.Constant(V.mesh, -0.01)
    bcs = scenes.hold(V, [(k, scenes.on(2, 0.0)) for k in range(3)])
    bcs += [fem.dirichletbc(c, _of(V, tags, k), V.sub(k)) for k, c in ((0, drag), (2, down))]
    options = {"solver": solver} | kwargs
    problem = scenes.block_problem(V, tags, bcs=bcs, loads=[], law=law, options=options)
    problem.solve()
    fails()
    drag.value = 0.004
    problem.solve(increments=increments)
    return problem, np.concatenate([side.force for side in problem.results[0].sides])


def _of(V, tags, k):
    return fem.locate_dofs_topological(V.sub(k), 2, tags.find(4))


@pytest.fixture
def failing(monkeypatch):
    """Makes steps of forms fail from then on."""

    def unsettled(*_):
        raise llm.ContactError(UNSETTLED)

    return lambda *forms: [monkeypatch.setattr(form, "solve", unsettled) for form in forms]


@pytest.mark.parametrize("law", [llm.Coulomb(0.3), llm.Frictionless()], ids=["mu", "none"])
@pytest.mark.parametrize("increments", [1, 2])
@pytest.mark.parametrize(
    ("solver", "form", "other"),
    [("condensed", CondensedForm, "flexibility"), ("saddle", Flexibility, "condensed")],
)
def test_goes_on_from_where_the_last_step_ended(law, increments, solver, form, other, failing):
    """With the same forces; later steps have that form, which is said."""
    _, expected = dragged(law, solver, increments=increments)
    problem, forces = dragged(law, solver, lambda: failing(form), increments=increments)
    assert np.abs(forces - expected).max() <= 1e-8 * np.abs(expected).max()
    assert problem.form == other and f"load steps go on by {other}" in str(problem)
    # Without friction the upper block may go along y, in this state as in all.
    assert "leaves a motion open" not in str(problem)
    problem.solve()


def test_an_error_tells_of_both_forms(failing):
    """Where neither comes to rest, and of the first alone where options ask for it."""
    both = f"{UNSETTLED}.*go on by flexibility: {UNSETTLED}.*Parts down to"
    with pytest.raises(llm.ContactError, match=both):
        dragged(llm.Coulomb(0.3), "condensed", lambda: failing(CondensedForm, Flexibility))
    options = {"petsc_options": {"pc_type": "lu"}}
    with pytest.raises(llm.ContactError, match=f"^{UNSETTLED}. Parts down to"):
        dragged(llm.Coulomb(0.3), "condensed", lambda: failing(CondensedForm), **options)


def pushed(solver):
    """Forces of each load step of a T joint beside a plane of symmetry, friction in all joints,
    whose top is pressed down, unevenly, and then pushed along."""
    blocks = [[[0, 0, 0], [2, 0.5, 1]], [[0, 0.5, 0], [1, 1, 1]], [[1, 0.5, 0], [2, 1, 1]]]
    counts = [(5, 2, 3), (4, 2, 4), (2, 2, 2)]
    wall = walls.Wall(MPI.COMM_SELF, np.array(blocks, dtype=float), counts, "hexahedron")
    V, bcs, moved = wall.V, wall.base(), []
    for axis in (0, 1):
        own, _ = V.sub(axis).collapse()
        top = fem.locate_dofs_geometrical((V.sub(axis), own), lambda x: np.isclose(x[1], 1.0))
        moved.append(fem.Function(own))
        bcs.append(fem.dirichletbc(moved[axis], top, V.sub(axis)))
    plane = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], 0.0))
    bcs.append(fem.dirichletbc(0.0, (3 * plane + 2).astype(np.int32), V.sub(2)))
    a, L = wall.forms(None, 0.0)
    moved[1].interpolate(lambda x: -0.01 * (0.7 + 0.3 * x[0]))
    interfaces, found = wall.interfaces(llm.Coulomb(0.8)), []
    with llm.ContactProblem(a, L, bcs=bcs, interfaces=interfaces, solver=solver) as problem:
        for drag in (0.0, 0.003, 0.008):
            moved[0].x.array[:] = drag
            problem.solve()
            found.append(np.concatenate([s.force for r in problem.results for s in r.sides]))
    return found


def test_forms_agree_where_one_comes_to_no_rest():
    """Bodies that were asked once came to none in the second step, which was an error."""
    for a, b in zip(pushed("saddle"), pushed("condensed"), strict=True):
        assert np.abs(a - b).max() <= 1e-8 * np.abs(b).max()


@pytest.mark.parametrize("ranks", [1, longer(3)])
def test_goes_on_between_bodies_of_several_laws(ranks):
    """One of which remembers what has slid, in the middle of load steps, on any number of ranks."""
    asked_for = other_form.of_all(MPI.COMM_SELF)
    found = asked_for if ranks == 1 else run_mpi_json("other_form.py", ranks)
    expected = asked_for["saddle"][0]
    for solver in other_form.FIRST:
        for steps in found[solver]:
            for a, b in zip(steps, expected, strict=True):
                assert np.abs(np.subtract(a, b)).max() <= 1e-10 * np.abs(b).max()
