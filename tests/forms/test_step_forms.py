"""A form of (31) as a plug-in, dense in NumPy; rows that give way."""

import numpy as np
import pytest
from contact_scenes import random_pressed, violations
from mpi4py import MPI
from scipy.sparse import csr_matrix

import dolfinx_llm as llm
from dolfinx_llm.contact import equations
from dolfinx_llm.forms import choice
from dolfinx_llm.forms.floating import Floating
from dolfinx_llm.forms.step import Displacement, StepResult, wrong_signs
from dolfinx_llm.problem import methods

COMM = MPI.COMM_SELF


def dense(M):
    rows, columns, values = M.getValuesCSR()
    return csr_matrix((values, columns, rows), M.getSize()).toarray()


class DenseForm:
    """(31) with the rows of a law, solved as a dense system; wrong signs are left to the law."""

    name, accuracy, noise, proximal = "NumPy", 1e-12, 0.0, 1e-10

    def __init__(self, form, bulk, operators, prefix, options):
        rows, fixed = operators.rows.numbering, operators.dofs.fixed
        self.comm, self.scale, self.free = operators.comm, operators.scale, ~fixed
        self.K, self.B = dense(bulk.K), dense(operators.B)[:, rows.number]
        self.floating = Floating(bulk.K, operators.B, rows, operators.bodies, fixed)

    def solve(self, f, step):
        c, on = self.scale, np.flatnonzero(step.active)
        n, k, m = len(f), len(on), step.L.shape[1]
        pinned, load = self.K.copy(), f.copy()
        at = self.floating.pins
        pinned[at, at] += step.spring
        load[at] += step.spring * self.floating.at_pins(step.anchor)
        A = np.zeros((n + k + m, n + k + m))  # of u, λ / c, w
        A[:n, :n], A[:n, n : n + k] = pinned / c, self.B[:, on]
        A[n : n + k, :n], A[n : n + k, n + k :] = self.B[:, on].T, -step.L[on].toarray()
        A[n : n + k, n : n + k] = -c * np.diag(step.compliance[on])
        A[n + k :, n : n + k], A[n + k :, n + k :] = step.E[:, on].toarray(), step.D.toarray() / c
        x = np.linalg.solve(A, np.concatenate([load / c, -step.g[on], step.rhs / c]))
        self.f, self.u, multiplier = f, x[:n], np.zeros(len(step.active))
        multiplier[on], w, y = c * x[n : n + k], x[n + k :], self.B.T @ x[:n]
        wrong = wrong_signs(step, multiplier, y, w, c)
        return StepResult(multiplier, y, w, self.floating.amounts(self.u), step.active, wrong)

    def correct(self, found):
        """Every step solves all."""

    def displacement(self, found):
        left = self.K @ self.u + self.B @ found.multiplier - self.f
        terms = np.diagonal(self.K) * self.u
        return Displacement(self.u, left * self.free, terms * self.free, self.f * self.free)

    def destroy(self):
        """Nothing of PETSc's."""


@pytest.mark.parametrize("seed", [402, 403, 407, 414, 418, 435])
def test_own_form(seed, monkeypatch):
    """Random scenes of all laws: what the forms of the package find."""
    monkeypatch.setattr(choice, "FLEXIBLE", 10**6)
    answers = []
    for own in (False, True):
        if own:
            monkeypatch.setattr(methods, "build_steps", DenseForm)
        scene, motions = random_pressed(COMM, seed)
        found = [f.x.array.copy() for motion in motions for f in scene.move(motion)]
        assert max(violations(scene.problem).values()) <= 1e-9
        answers.append(np.concatenate(found))
    assert np.abs(answers[0] - answers[1]).max() <= 1e-9 * np.abs(answers[0]).max()


def test_compliance(monkeypatch):
    """A row of compliance s is a spring 1 / s: all forms that have such rows agree, and the body
    comes nearer by s λ; where rows are eliminated they are refused."""
    before = equations.Equations.__init__
    softness = 1e-5

    def soft(self, operators, proximal):
        before(self, operators, proximal)
        self.compliance = np.where(self.normal, softness, 0.0)

    monkeypatch.setattr(equations.Equations, "__init__", soft)
    answers = []
    for solver, limit in (("auto", 10**6), ("saddle", 0), ("dense", 10**6), ("condensed", 0)):
        monkeypatch.setattr(choice, "FLEXIBLE", limit)
        with monkeypatch.context() as m:
            if solver == "dense":
                m.setattr(methods, "build_steps", DenseForm)
            scene, motions = random_pressed(COMM, 402, solver="auto" if limit else solver)
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
