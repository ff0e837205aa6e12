"""A form of (31) as a plug-in, dense in NumPy; rows that give way."""

from dataclasses import replace

import changed
import numpy as np
import pytest
import scenes
from contact_scenes import random_pressed, violations
from mpi4py import MPI
from sampling import some_of
from scipy.sparse import csr_matrix

import dolfinx_llm as llm
from dolfinx_llm.contact.equations import equations
from dolfinx_llm.forms import choice
from dolfinx_llm.forms.step import LinearStep

COMM = MPI.COMM_SELF


def dense(M):
    rows, columns, values = M.getValuesCSR()
    return csr_matrix((values, columns, rows), M.getSize()).toarray()


class DenseForm(llm.StepForm):
    """(31) with the rows of a law, solved as a dense system; wrong signs are left to the law."""

    name, accuracy = "NumPy", 1e-13

    def prepare(self, K, operators):
        super().prepare(K, operators)
        self.K_dense, self.B_dense = dense(K), dense(operators.B)
        self.B_dense = self.B_dense[:, operators.rows.numbering.number]

    def solve(self, f, step):
        c, on, B = self.operators.scale, np.flatnonzero(step.active), self.B_dense
        n, k, m = len(f), len(on), step.L.shape[1]
        A = np.zeros((n + k + m, n + k + m))  # of u, λ / c, w
        A[:n, :n], A[:n, n : n + k] = self.K_dense / c, B[:, on]
        A[step.pins, step.pins] += step.spring / c
        A[n : n + k, :n], A[n : n + k, n + k :] = B[:, on].T, -step.L[on].toarray()
        A[n : n + k, n : n + k] = -c * np.diag(step.compliance[on])
        A[n + k :, n : n + k], A[n + k :, n + k :] = step.E[:, on].toarray(), step.D.toarray() / c
        b = np.concatenate([step.loaded(f) / c, -step.g[on], step.rhs / c])
        x, multiplier = np.linalg.solve(A, b), np.zeros(len(step.active))
        multiplier[on] = c * x[n : n + k]
        return self.result(step, x[:n], multiplier, x[n + k :])


@pytest.mark.parametrize("seed", some_of([402, 403, 407, 414, 418, 435], [403, 407, 418]))
def test_own_form(seed, monkeypatch):
    """Random scenes of all laws: what the forms of the package find."""
    monkeypatch.setattr(choice, "FLEXIBLE", 10**6)
    answers = []
    for solver in ("saddle", DenseForm()):
        scene, motions = random_pressed(COMM, seed, solver=solver)
        found = [f.x.array.copy() for motion in motions for f in scene.move(motion)]
        assert max(violations(scene.problem).values()) <= 1e-9
        answers.append(np.concatenate(found))
    assert scene.problem.form == "NumPy" and "solver: NumPy (as given)" in str(scene.problem)
    assert np.abs(answers[0] - answers[1]).max() <= 1e-9 * np.abs(answers[0]).max()


@pytest.mark.parametrize("law", changed.LAWS)
def test_own_form_follows_changes(law):
    """Tied, too: ``prepare`` takes over what has changed, and one object goes on serving."""
    answers = []
    for own in (False, True):
        data = changed.Data(COMM)
        problem = data.problem(law, DenseForm() if own else "saddle")
        answers.append([])
        for change in (lambda data: None, changed.modulus, changed.dofs, changed.mesh):
            change(data)
            answers[-1] += [problem.solve().x.array.copy(), problem.results[0].sides[1].force]
        problem.destroy()
    for known, found in zip(*answers, strict=True):
        assert np.abs(known - found).max() <= 1e-9 * np.abs(known).max()


def test_own_form_serves_one_problem():
    data, form = changed.Data(COMM), DenseForm()
    problems = [data.problem("tied", form) for _ in range(2)]
    for problem in problems:
        problem.solve()
    with pytest.raises(llm.ContactError, match="handed to another problem"):
        problems[0].solve()


def test_options_of_an_own_form_are_its_own():
    V, tags = scenes.two_blocks(COMM)
    a, L = scenes.forms(V)
    with pytest.raises(llm.ContactInputError, match="of the package's own forms"):
        llm.ContactProblem(
            a, L, interfaces=llm.Interface(tags, (2, 3)), solver=DenseForm(),
            petsc_options={"ksp_rtol": 1e-3},
        )  # fmt: skip


def test_compliance(monkeypatch):
    """A row of compliance s is a spring 1 / s: all forms that have such rows agree, and the body
    comes nearer by s λ; where rows are eliminated they are refused."""
    before = equations.Equations.__init__
    softness = 1e-5

    def soft(self, operators):
        before(self, operators)
        self.compliance = np.where(self.normal, softness, 0.0)

    monkeypatch.setattr(equations.Equations, "__init__", soft)
    answers = []
    for solver, limit in (("saddle", 10**6), ("saddle", 0), (DenseForm(), 10**6), ("condensed", 0)):
        monkeypatch.setattr(choice, "FLEXIBLE", limit)
        scene, motions = random_pressed(COMM, 402, solver=solver)
        if solver == "condensed":
            with pytest.raises(llm.ContactError, match="rows that give way"):
                scene.move(motions[0])
            continue
        answers.append(np.concatenate([f.x.array for f in scene.move(motions[0])]))
        for side in scene.problem.results[0].sides:
            closed = side.status != 0
            away = np.abs(side.frame_gap + softness * side.normal_force)[closed]
            assert closed.any() and away.max() <= 1e-9 * np.abs(side.u).max()
    for other in answers[1:]:
        assert np.abs(other - answers[0]).max() <= 1e-9 * np.abs(answers[0]).max()


def test_ties_are_symmetric():
    """Ties alone by what they are, which nothing is multiplied for; others by their rows."""
    step = LinearStep.tied(csr_matrix([[1.0, 0.0], [0.5, 0.5]]), np.zeros(2))
    assert replace(step, E=None).symmetric and step.transposed().symmetric
    assert replace(step, ties=False).symmetric
    assert not replace(step, E=2.0 * step.E, ties=False).symmetric
