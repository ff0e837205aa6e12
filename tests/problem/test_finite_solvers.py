"""Newton's systems by GMRES with GAMG, against their factorisation."""

import finite_patch
import numpy as np
import patch2d
import pytest
from conftest import run_mpi_json
from mpi4py import MPI
from sampling import longer
from test_finite_deformation_3d import turned
from turned_strips import Strips

import dolfinx_llm as llm
from dolfinx_llm.finite.linear import multigrid
from dolfinx_llm.problem import nonlinear_system

COMM = MPI.COMM_SELF


def strips(law):
    """Strips in the plane, pressed and sheared."""
    scene = Strips(law, COMM)
    scene.step(0.0)
    scene.step(0.03)
    return scene.problem


def patch(cells, law, refine=1, pressure=300.0):
    """The finite patch test in space."""
    bodies = patch2d.bodies(COMM, cells, refine, True, boxes=finite_patch.BOXES[3], rough=0.2)
    problem = finite_patch.problem(bodies, law=law, pressure=pressure)
    problem.solve()
    return problem


SCENES = {
    "strips, slip and stick": lambda: strips(llm.Coulomb(0.2)),
    "strips, tied": lambda: strips(llm.Tied()),
    "hexahedra, friction, turned": lambda: turned("hex", llm.Coulomb(0.2), 40.0)[0],
    "held side": lambda: turned("tet", llm.Frictionless(), held=True, cells=(4, 3))[0],
    "follower pressure": lambda: patch("tet", llm.Frictionless()),
    "supports at a tied side": lambda: patch("hex", llm.Tied(), 2, 3.0),
    "supports where friction sticks": lambda: patch("hex", llm.Coulomb(0.3), 2, 3.0),
}


OTHERS = {"strips, tied", "held side", "supports where friction sticks"}


@pytest.mark.parametrize("name", [longer(name) if name in OTHERS else name for name in SCENES])
def test_same_answers(name, monkeypatch, caplog):
    """Both ways, displacements and forces are the same; so are Newton's iterations."""
    found = []
    for method, limit in (("saddle", 10**9), ("condensed", 0)):
        monkeypatch.setattr(nonlinear_system, "FROM_UNKNOWNS", {2: limit, 3: limit})
        problem = SCENES[name]()
        assert problem.method == method and f"solver: {method} (chosen" in str(problem)
        assert all((h["linear"] > 0) == (method == "condensed") for h in problem.history)
        found.append(problem)
    assert "MUMPS instead" not in caplog.text
    one, other = found
    assert len(other.history) <= len(one.history) + 1
    for u, w in zip(one.bulk.u, other.bulk.u, strict=True):
        assert np.abs(u.x.array - w.x.array).max() < 1e-9 * np.abs(u.x.array).max()
    for a, b in zip(one.results[0].sides, other.results[0].sides, strict=True):
        assert np.abs(a.force - b.force).max() < 1e-9 * np.abs(a.force).max()


@pytest.mark.parametrize("law", [longer(llm.Frictionless()), llm.Tied()], ids=str)
def test_iterations_do_not_grow(monkeypatch, law):
    """Four times as many unknowns take about as many iterations to the same residual, 1e-5 of the
    first solves; one level of a preconditioner would take 1.6 times as many. Those of the last
    solves, to residuals that Newton's iteration asks for, stay below 1.5 times one body's 15, with
    supports at the interface as well: ties took 27 where rows of held nodes were condensed as if
    each stood alone."""
    monkeypatch.setattr(nonlinear_system, "FROM_UNKNOWNS", {3: 0})
    coarse, fine = (patch("hex", law, refine, 3.0) for refine in (3, 5))
    assert fine.unknowns["u"] > 4.0 * coarse.unknowns["u"]
    one, other = (problem.history[0]["linear"] for problem in (coarse, fine))
    assert other <= 1.25 * one
    assert max(h["linear"] for h in fine.history) < 22


def test_mumps_takes_over(monkeypatch, caplog):
    """Where GMRES gives no answer a factorisation does, and a warning says so."""
    monkeypatch.setattr(nonlinear_system, "FROM_UNKNOWNS", {2: 0})
    monkeypatch.setitem(multigrid.GMRES, "ksp_max_it", 2)
    bodies = patch2d.bodies(COMM, "quad", separate=True)
    problem = finite_patch.problem(bodies)
    problem.solve()
    assert max(finite_patch.errors(problem, finite_patch.stretches(300.0))) < 1e-9
    assert "MUMPS instead" in caplog.text and "from now on" in caplog.text


def test_two_ranks():
    """The same forces as of the factorised system on one."""
    two = run_mpi_json("finite_ranks.py", 2, "tet", "condensed")
    assert two["stretch"] < 1e-10 and two["pressure"] < 1e-9
    one = finite_patch.problem(patch2d.bodies(COMM, "tet", boxes=finite_patch.BOXES[3]))
    one.solve()
    force = np.concatenate([side.force.ravel() for side in one.results[0].sides])
    assert np.allclose(two["force"], force, rtol=1e-9, atol=1e-9 * 300.0)


@pytest.mark.parametrize("given", [{"ksp_type": "preonly", "pc_type": "lu"}, {"ksp_type": "gmres"}])
def test_options_of_a_factorisation(given):
    """What dolfinx programs give for a direct solve, and a Krylov method on top of it."""
    exact = turned("hex", llm.Frictionless())[0]
    found = turned("hex", llm.Frictionless(), petsc_options=given)[0]
    difference = found.u.x.array - exact.u.x.array
    assert np.abs(difference).max() < 1e-10 * np.abs(exact.u.x.array).max()


def test_methods_that_do_not_suit():
    with pytest.raises(llm.ContactInputError, match="ksp_type='cg' .*give 'gmres'"):
        turned("hex", llm.Frictionless(), solver="condensed", petsc_options={"ksp_type": "cg"})
