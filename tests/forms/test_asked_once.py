"""Contact that comes to no rest in one form of the system: bodies are asked once from then on."""

import numpy as np
import pytest
import scenes
from dolfinx import fem
from mpi4py import MPI

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
def test_goes_on_from_where_the_last_step_ended(law, increments, failing):
    """With the same forces; later steps have that form, which is said."""
    _, expected = dragged(law, "saddle", increments=increments)
    problem, forces = dragged(
        law, "condensed", lambda: failing(CondensedForm), increments=increments
    )
    assert np.abs(forces - expected).max() <= 1e-8 * np.abs(expected).max()
    assert problem.form == "flexibility" and "bodies are asked once" in str(problem)
    problem.solve()


def test_an_error_tells_of_both_forms(failing):
    """Where neither comes to rest, and of the first alone where options ask for it."""
    both = f"{UNSETTLED}.*asked once.*{UNSETTLED}.*Parts down to"
    with pytest.raises(llm.ContactError, match=both):
        dragged(llm.Coulomb(0.3), "condensed", lambda: failing(CondensedForm, Flexibility))
    options = {"petsc_options": {"pc_type": "lu"}}
    with pytest.raises(llm.ContactError, match=f"^{UNSETTLED}. Parts down to"):
        dragged(llm.Coulomb(0.3), "condensed", lambda: failing(CondensedForm), **options)
