"""What small problems need not pay for: it is not done, and nobody misses it."""

import finite_patch
import numpy as np
import pytest
import scenes
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.finite import newton
from dolfinx_llm.forms.condensed import reduced, system
from dolfinx_llm.geometry.location import ClosestPoints

COMM = MPI.COMM_SELF
CHOLESKY = {"ksp_type": "preonly", "pc_type": "cholesky"}


def counted(monkeypatch, owner, name, said):
    """Appends to a list whenever a function is called."""
    kept = getattr(owner, name)
    monkeypatch.setattr(owner, name, lambda *of, **k: said.append(name) or kept(*of, **k))


def test_factorised_ties(monkeypatch):
    """Both sides are located on the frame at once. No rigid motions for multigrid, nor as a start;
    L_b is a PETSc matrix once it is asked for. With multigrid the motions are there."""
    found, said = [], []
    counted(monkeypatch, system, "near_null_space", said)
    counted(monkeypatch, reduced.ReducedMatrix, "take", said)
    counted(monkeypatch, ClosestPoints, "locate", said)
    for options, expected in ((CHOLESKY, []), (None, ["near_null_space", "take"])):
        options = {"solver": "condensed", "petsc_options": options}
        problem = scenes.block_problem(*scenes.two_blocks(COMM), options=options)
        found.append(problem.solve().x.array.copy())
        assert said == ["locate", *expected]
        said.clear()
        assert "L_b" not in vars(problem.operators)
        assert problem.L_b.getSize() == (problem.unknowns["lambda"], problem.unknowns["v"])
        assert problem.L_b is problem.operators.L_b
        problem.destroy()
    np.testing.assert_allclose(*found, atol=1e-10 * np.abs(found[0]).max())


@pytest.mark.parametrize("gap", [0.0, 0.01])
def test_begun_once(monkeypatch, gap):
    """At finite deformation bodies that touch as drawn, or that supports hold apart, are looked at
    once before the first iteration."""
    said = []
    counted(monkeypatch, newton, "Increment", said)
    parts = [scenes.grid(n, 2, (0.0, y), (1.0, y + 1.0)) for n, y in ((3, 0.0), (4, 1.0 + gap))]
    ends = np.cumsum([0, *(len(x) for x, _ in parts)])
    cells = [c[:, [0, 1, 3, 2]] + first for (_, c), first in zip(parts, ends)]
    where = [(1, 0, scenes.on(1, 0.0)), (2, 0, scenes.on(1, 1.0)), (3, 1, scenes.on(1, 1.0 + gap))]
    x = [x for x, _ in parts]
    domain, tags = scenes.bodies_mesh(COMM, x, cells, "quadrilateral", list(ends), where)
    V = compat.function_space(domain, shape=(2,))
    u, moved = fem.Function(V), fem.Function(V)
    F = finite_patch.residual(u, 1.0, 1.0)
    ends = [fem.locate_dofs_geometrical(V, scenes.on(1, y)) for y in (0.0, 2.0 + gap)]
    moved.x.array.reshape(-1, 2)[ends[1]] = [0.0, -0.02]
    bcs = [fem.dirichletbc(np.zeros(2), ends[0], V), fem.dirichletbc(moved, ends[1])]
    interface = llm.Interface(tags, (2, 3), law=llm.Frictionless())
    with llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface]) as problem:
        problem.solve()
        assert (problem.results[0].pressure > 0.0).all() and said == ["Increment"]
