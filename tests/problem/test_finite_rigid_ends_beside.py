"""Rigid ends beside contact of another law, two of them which move and turn differently, against
the same motion by conditions. As a script it prints what several ranks find."""

import itertools
import json
import sys
from unittest import mock

import numpy as np
import pytest
import ufl
from conftest import run_mpi_json
from dolfinx import fem
from end_scenes import Stack
from mpi4py import MPI
from sampling import longer
from upright_blocks import FOOT, block

import dolfinx_llm as llm
from dolfinx_llm.finite import newton
from dolfinx_llm.laws.rows import SLIP

LAWS = {"free": llm.Frictionless(), "rubs": llm.Coulomb(0.3), "tied": llm.Tied()}
PARTS = 0.25, 0.5, 0.75, 1.0
QUICK = {("quad", 1, "rubs", "saddle"), ("quad", 2, "free", "condensed")}
EVERY = [
    each if each in QUICK else longer(*each)
    for each in itertools.product(("quad", "tet"), (1, 2), LAWS, ("saddle", "condensed"))
    if each[:2] != ("tet", 2)
]


def gone(kind, law, solver, tied, degree=1, comm=MPI.COMM_SELF, parts=PARTS):
    """The scene and its problem at the end of the way."""
    scene = Stack(kind, LAWS[law], tied, degree, comm)
    problem = scene.problem(solver=solver)
    for part in parts:
        scene.move(part)
        problem.solve()
    return scene, problem


@pytest.mark.parametrize(("kind", "degree", "law", "solver"), EVERY)
def test_as_prescribed_by_conditions(kind, degree, law, solver):
    """Displacements, forces between the blocks, and what the ends bear is in balance with them."""
    (scene, ends), (other, conditions) = (
        gone(kind, law, solver, tied, degree) for tied in (True, False)
    )
    assert np.abs(scene.values() - other.values()).max() < 1e-11
    found, known = (p.results[0] for p in (ends, conditions))
    size = np.abs(known.resultant).max()
    assert size > 1.0
    for a, b in zip(found.sides, known.sides, strict=True):
        assert np.abs(a.force - b.force).max() < 1e-9 * size
        assert np.array_equal(a.status, b.status)
    if law == "rubs":
        assert (np.concatenate([s.status for s in found.sides]) == SLIP).any()
    total = [result.sides[0].force.sum(axis=0) for result in ends.results]
    assert np.abs(total[0] + total[1]).max() < 1e-9 * size
    assert np.abs(total[1] + total[2]).max() < 1e-9 * size


@pytest.mark.parametrize(("kind", "law", "solver"), [
    ("quad", "rubs", "saddle"), longer("quad", "free", "condensed"),
    longer("tet", "rubs", "condensed"), longer("tet", "free", "saddle"),
])  # fmt: skip
def test_a_motion_that_forces_bring_about(kind, law, solver):
    """A force and a moment press the upper end, which is dragged; what they move it by, prescribed
    in the same parts, takes the same forces."""
    dim, poses, forces = 2 if kind == "quad" else 3, [], []
    for prescribed in (False, True):
        scene = Stack(kind, LAWS[law], tied=True)
        end, problem = scene.ends[1], None
        for step, part in enumerate(PARTS):
            if prescribed:
                end.displacement, turn = poses[step]
                end.rotation = turn if dim == 3 else turn[0]
            else:
                end.displacement = 0.03 * part * np.eye(dim)[0]
                end.force = (*(None,) * (dim - 1), -30.0 * part)
                end.moment = part if dim == 2 else (part, None, None)
            problem = problem or scene.problem(solver=solver)
            problem.solve()
            result = problem.results[-1]
            if not prescribed:
                poses.append((result.displacement.copy(), result.rotation.copy()))
                assert abs(result.resultant[-1] - 30.0 * part) < 1e-8
        forces.append(np.concatenate([r.sides[0].force.ravel() for r in problem.results]))
    assert np.abs(forces[0] - forces[1]).max() < 1e-8 * np.abs(forces[0]).max()


@pytest.mark.parametrize(("kind", "degree", "solver"), [
    ("quad", 2, "saddle"), longer("quad", 1, "condensed"),
    longer("tet", 1, "saddle"), longer("tet", 2, "condensed"),
])  # fmt: skip
def test_two_ends_of_one_body(kind, degree, solver):
    """That move and turn differently: as if prescribed, and their forces are in balance."""
    found = []
    for tied in (True, False):
        scene = Stack(kind, None, tied, degree)
        problem = scene.problem(solver=solver)
        for part in PARTS:
            scene.move(part, drag=0.2, press=-0.1, tilt=0.4)
            problem.solve()
        found.append(scene.values())
        if tied:
            total = [result.resultant for result in problem.results]
            assert np.abs(total[0] + total[1]).max() < 1e-9 * np.abs(total[0]).max()
    assert np.abs(found[0] - found[1]).max() < 1e-11


@pytest.mark.parametrize("law", ["free", longer("rubs")])
def test_a_step_that_fails_is_taken_back(law, tmp_path, monkeypatch):
    """What is saved before it goes on as if it had not been tried; so does a problem that has been
    reset, from rest."""
    known = gone("quad", law, "saddle", True)[0].values()
    scene, problem = gone("quad", law, "saddle", True, parts=PARTS[:2])
    problem.save(tmp_path / "state.npz")
    before = scene.values()
    scene.move(0.5, press=1e3)  # through the block below
    monkeypatch.setattr(newton, "HALVINGS", 2)
    with pytest.raises(llm.ContactError, match="Newton's iteration fails at"):
        problem.solve()
    problem.load(tmp_path / "state.npz")
    assert np.array_equal(scene.values(), before)
    for anew in (False, True):
        if anew:
            for u in scene.u:
                u.x.array[:] = 0.0
            problem.reset()
        for part in PARTS[0 if anew else 2 :]:
            scene.move(part)
            problem.solve()
        assert np.abs(scene.values() - known).max() < 1e-11


@pytest.mark.parametrize("solver", ["saddle", "condensed"])
@pytest.mark.parametrize("linear", [False, True])
def test_supports_go_before_ends(linear, solver):
    """What a support prescribes at a node of an end holds, whether the end's motion agrees or not,
    and the others follow the end: in linear problems and at finite deformation alike."""
    for there in ((0.01, 0.02), (0.0, 0.0)):
        _, tags, V, u, F = block("quad", 3)
        end = llm.RigidPlane((0.0, 0.0), (0.0, 1.0), displacement=(0.01, 0.02))
        held, x = fem.Function(V), V.tabulate_dof_coordinates()[:, :2]
        held.x.array.reshape(-1, 2)[:] = there
        corner = fem.locate_dofs_geometrical(V, lambda p: np.isclose(p[1], 0.0) & (p[0] < 0.1))
        top = fem.locate_dofs_geometrical(V, lambda p: np.isclose(p[1], 1.0))
        given = {
            "bcs": [fem.dirichletbc(held, corner), fem.dirichletbc(fem.Function(V), top)],
            "interfaces": llm.Interface(tags, (FOOT, end), law=llm.Tied()),
            "solver": solver,
        }
        if linear:
            v, w = ufl.TrialFunction(V), ufl.TestFunction(V)
            a = ufl.inner(ufl.sym(ufl.grad(v)), ufl.sym(ufl.grad(w))) * ufl.dx
            L = ufl.inner(fem.Function(V), w) * ufl.dx
            u = llm.ContactProblem(a, L, **given).solve()
        else:
            llm.NonlinearContactProblem(F, u, **given).solve()
        foot, values = np.isclose(x[:, 1], 0.0), u.x.array.reshape(-1, 2)
        own = np.isin(np.arange(len(x)), corner)
        assert np.abs(values[foot & ~own] - (0.01, 0.02)).max() < 1e-12
        assert np.abs(values[own] - there).max() < 1e-12


def told(comm, kind, law, solver, fails):
    """Forces of all interfaces, and the text of an error where a step is asked for that fails."""
    scene, problem = gone(kind, law, solver, True, comm=comm, parts=PARTS[:2])
    force = [side.force.ravel() for result in problem.results for side in result.sides]
    text = ""
    if fails:
        scene.move(0.5, press=1e3)
        with mock.patch.object(newton, "HALVINGS", 2), pytest.raises(llm.ContactError) as error:
            problem.solve()
        text = str(error.value)[:35]
    return np.concatenate(force).tolist(), text


@pytest.mark.parametrize(("n", "kind", "law", "solver", "fails"), [
    (2, "quad", "rubs", "condensed", False), (2, "quad", "free", "saddle", True),
    longer(2, "quad", "rubs", "condensed", True), longer(3, "quad", "free", "saddle", True),
    longer(2, "tet", "rubs", "saddle", True), longer(3, "tet", "free", "condensed", True),
    longer(3, "tet", "rubs", "condensed", True),
])  # fmt: skip
def test_ranks(n, kind, law, solver, fails):
    several = run_mpi_json(__file__, n, kind, law, solver, *(["fails"] if fails else []))
    force, text = told(MPI.COMM_SELF, kind, law, solver, fails)
    assert np.allclose(several["force"], force, rtol=1e-8, atol=1e-9 * np.abs(force).max())
    assert several["text"] == text and bool(text) == fails


if __name__ == "__main__":
    force, text = told(MPI.COMM_WORLD, *sys.argv[1:4], len(sys.argv) > 4)
    assert len({json.dumps(each) for each in MPI.COMM_WORLD.allgather([force, text])}) == 1
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps({"force": force, "text": text}))
