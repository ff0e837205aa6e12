"""What is said of load steps that no equilibrium ends, and how soon."""

import re

import finite_patch
import numpy as np
import pytest
import scenes
import test_finite_deformation as fd
import ufl
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.finite.failures import NothingHolds
from dolfinx_llm.finite.newton import NewtonSteps


def two(shift, load=(0.0, 0.0), degree=1, top=None, cells=(4, 4)):
    """Two blocks under a body force, of which the lower one is held; the motion of the top, or
    None."""
    domain, tags = fd.blocks(cells, (1.0, 0.6), shift=shift)
    V = compat.function_space(domain, degree=degree, shape=(2,))
    u, bcs = fem.Function(V), []
    F = finite_patch.residual(u, *finite_patch.lame(100.0, 0.3), degree)
    F -= ufl.inner(fem.Constant(domain, load), ufl.TestFunction(V)) * ufl.dx
    for tag, motion in ((fd.BOTTOM, (0.0, 0.0)), *([(fd.TOP, top)] if top else [])):
        dofs = fem.locate_dofs_topological(V, 1, tags.indices[tags.values == tag])
        bcs.append(fem.dirichletbc(np.array(motion), dofs, V))
    interface = llm.Interface(tags, (fd.LOW, fd.HIGH), law=llm.Frictionless())
    return llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=interface)


@pytest.mark.parametrize("degree", [1, 2])
def test_nothing_holds_a_body(degree):
    """It lies beside what it is to touch. At second order the solver leaves out its rigid motions:
    225 iterations changed nothing before the error."""
    problem = two(1.3, (0.0, -1.0), degree)
    try:
        problem.solve()
    except llm.ContactError as error:
        said = str(error)
    else:  # rounding of the processor has thrown it onto the other one, where it rests
        assert problem.results[0].resultant == pytest.approx([0.0, 0.6], abs=1e-9)
        return
    assert re.search(r"at the node drawn at \[[^]]*\], next to", said)
    assert "the interface between tag 2 and tag 3: nothing holds" in said
    x = np.array(said.split("drawn at [")[1].split("]")[0].split(","), dtype=float)
    low, high = np.array([1.3, 1.0]), np.array([1.9, 2.0])  # the upper block, any node of which it
    assert (low - 1e-9 < x).all() and (x < high + 1e-9).all()  # may be: the motion is rigid
    if degree == 2:  # at first order rounding moves the body, up to 1e9 in the end
        assert len(problem.history) <= 40


def test_halves_that_succeed_are_tried_again(monkeypatch):
    """Increments grow again after one that succeeds: a failure at the old size is not the second
    one in a row."""
    lengths, increment = [], NewtonSteps._increment

    def short(newton, step, end, bar):
        lengths.append(end - sum(done for done, ok in lengths if ok))
        lengths[-1] = lengths[-1], lengths[-1] < 0.4
        if not lengths[-1][1]:
            raise NothingHolds("longer than 0.4")
        return increment(newton, step, end, bar)

    monkeypatch.setattr(NewtonSteps, "_increment", short)
    two(0.17, top=(0.0, -0.05), cells=(2, 3)).solve(increments=2)
    assert [ok for _, ok in lengths] == [False, True, False, True, False, True, True]


def test_a_body_is_pushed_through_another(monkeypatch):
    """The error says where most is left, and next to which interface."""
    monkeypatch.setattr("dolfinx_llm.finite.newton.HALVINGS", 1)
    problem = two(0.17, top=(0.0, -3.0), cells=(2, 3))
    with pytest.raises(llm.ContactError, match="drawn at .*the interface between tag 2 and tag 3"):
        problem.solve()


def test_a_body_that_flies_away():
    """A block between two others, let go where nothing but its frictionless faces holds it: it came
    to rest without forces, 90 times as far away as all are large, with a warning alone."""
    u, F, tags, held = [], [], [], []
    for k, n in enumerate((4, 7, 5)):
        domain, marked = rectangle(MPI.COMM_SELF, (n, 3), (0, k), (1, k + 1), "triangle")
        V = compat.function_space(domain, shape=(2,))
        u.append(fem.Function(V))
        energy = finite_patch.energy(u[k], *finite_patch.lame(10.0, 0.3))
        F.append(ufl.derivative(energy * ufl.dx, u[k], ufl.TestFunction(V)))
        tags.append(marked)
        at, moved = (0.0, 1.0, 3.0)[k], (0.0, -0.03, -0.1)[k]
        where = fem.locate_dofs_geometrical(V, scenes.on(1, at))
        held.append(fem.dirichletbc(fem.Constant(domain, (0.0, moved)), where, V))
    between = [
        llm.Interface(None, ((low, ABOVE), (high, BELOW)), law=llm.Frictionless())
        for low, high in zip(tags, tags[1:])
    ]
    problem = llm.NonlinearContactProblem(F, u, bcs=held, interfaces=between)
    problem.solve()
    del held[1]
    with pytest.raises(llm.ContactError, match="Newton's iteration fails"):
        problem.solve()
    assert max(np.abs(f.x.array).max() for f in u) < 1.0
