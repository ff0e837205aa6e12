"""The hard cases of the demo at small size: right, refused with reason, or said to be inexact."""

import numpy as np
import pytest
import scenes
import stiff_cases
from dolfinx import fem
from mpi4py import MPI
from sampling import some_of

import dolfinx_llm as llm
from dolfinx_llm import compat

CASES = [
    (name, key, value, solver)
    for name, cases in stiff_cases.CASES.items()
    for key, value in cases
    for solver in stiff_cases.SOLVERS
]
BY_TURNS = [  # of large values all, by one form after the other
    row
    for k, row in enumerate(CASES)
    if (k % 7 == 0 if row[2] < 8.0 else row[2] > 16.0 and k // 2 % 2 == k % 2)
]
REFUSED = {("density", 2.0): "frame is too fine", ("density", 4.0): "frame is too fine"}
INEXACT = {("ratio", 1e8), ("sliver", 1e-8)}


@pytest.mark.parametrize(("name", "key", "value", "solver"), some_of(CASES, BY_TURNS))
def test_case(name, key, value, solver):
    size = 2 if value == 16.0 else 4
    row = stiff_cases.solve(size, MPI.COMM_SELF, solver=solver, **{key: value})
    if (key, value) in REFUSED:
        assert REFUSED[key, value] in row["refused"]
        return
    assert "refused" not in row, row["refused"]
    error = max(row["displacement"], row["pressure"])
    if (key, value) in INEXACT:  # said, and by about how much
        assert len(row["lost"]) == 1
        assert error <= 1e-6
    else:
        assert row["lost"] == []
        assert error <= (1e-8 if key in ("offset", "sliver", "aspect") else 1e-10)


@pytest.mark.parametrize("exponent", [5, 6, 7, 8])
def test_lost_digits_are_foreseen(exponent):
    """Of a stiff body on a soft one, by the factorisation of (31)."""
    contact, exact = stiff_cases.scene(MPI.COMM_SELF, 4, ratio=10.0**exponent, solver="saddle")
    contact.solve()
    error = abs(contact.results[0].pressure / stiff_cases.PRESSURE - 1.0).max()
    assert error <= 10.0 * contact.method.iteration.verdict.rounding
    assert contact.method.iteration.verdict.rounding <= 1e-16 * 10.0 ** (exponent + 2)


def test_row_too_long_for_gamg(monkeypatch):
    """A factorisation takes over, and "auto" takes the saddle form."""
    from dolfinx_llm.forms import cost
    from dolfinx_llm.forms.condensed import krylov
    from dolfinx_llm.forms.condensed import system as condensed

    for module in (condensed, krylov):
        monkeypatch.setattr(module, "WIDEST", 50.0)
    monkeypatch.setattr(cost, "SWEPT", 0.0)
    row = stiff_cases.solve(4, MPI.COMM_SELF, solver="condensed")
    assert row["method"] == "Cholesky" and "too many for GAMG" in row["notes"][0]
    assert max(row["displacement"], row["pressure"]) <= 1e-12
    contact, _ = stiff_cases.scene(MPI.COMM_SELF, 4)
    assert contact.form == "saddle" and "too many" in str(contact)


def test_slender_blocks_on_few_supports():
    """A stiff column tied to a soft one that stands on a corner, by multigrid: what it leaves would
    be lost in motions of the whole, were these taken out of it once more at the end."""
    V, tags = scenes.two_blocks(MPI.COMM_SELF, 4, 6, jitter=0.0)
    V.mesh.geometry.x[:, :2] /= 8.0
    soft = compat.function_space(V.mesh, "DG", 0)
    scale = fem.Function(soft)
    scale.x.array[:] = np.where(soft.tabulate_dof_coordinates()[:, 2] < 1.0, 1e-3, 1.0)
    corner = fem.locate_dofs_geometrical(V, lambda p: (p[2] < 1e-9) & (p[:2] < 0.04).all(axis=0))
    bcs, found = [fem.dirichletbc(np.zeros(3), corner, V)], []
    for solver in ("saddle", "condensed"):
        problem = scenes.block_problem(
            V, tags, bcs=bcs, scale=scale, options={"solver": solver}, law=llm.Tied()
        )
        assert problem.operators.firm
        u = problem.solve()
        found.append(u.x.array)
        assert problem.method.iteration.verdict.residual < 1e-8
    assert np.abs(found[0] - found[1]).max() < 1e-5 * np.abs(found[0]).max()
