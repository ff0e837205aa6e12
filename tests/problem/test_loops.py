"""Hundreds of load steps in which stiffness, loads and the length of steps change."""

from pathlib import Path

import numpy as np
import pytest
import ufl
from dolfinx import fem
from friction_block import BOTTOM, TOP, body, stress
from hertz2d import hold
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF
MOST = 0.02  # MB that a step may leave


def memory():
    """MB that this process has now."""
    told = Path("/proc/self/status").read_text().split("VmRSS:")[1]
    return int(told.split()[0]) / 1024.0


class Pressed:
    """A block pressed and dragged on another one, of a linear or a nonlinear problem."""

    def __init__(self, kind):
        bodies = [body(COMM, (-1.0, 0.0), (2.0, 1.0), (6, 3))]
        bodies.append(body(COMM, (-3.0, -2.0), (6.0, 2.0), (11, 4)))
        spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in bodies]
        linear = kind == "linear"
        fields = [ufl.TrialFunction(V) if linear else fem.Function(V) for V in spaces]
        self.moduli, self.loads, forms = [], [], [[], []]
        for (domain, tags), V, u in zip(bodies, spaces, fields, strict=True):
            E, p = (fem.Constant(domain, value) for value in (10.0, 0.0))
            w, ds = ufl.TestFunction(V), ufl.Measure("ds", domain=domain, subdomain_data=tags)
            forms[0].append(ufl.inner(stress(u, E, 0.3), ufl.grad(w)) * ufl.dx)
            forms[1].append(-p * w[1] * ds(TOP))
            self.moduli.append(E)
            self.loads.append(p)
        self.top = hold(spaces[0], 0, lambda x: np.isclose(x[1], 1.0))
        bcs = [self.top, *(hold(spaces[1], k, lambda x: np.isclose(x[1], -2.0)) for k in (0, 1))]
        sides = (bodies[0][1], BOTTOM), (bodies[1][1], TOP)
        options = {"bcs": bcs, "interfaces": [llm.Interface(None, sides, law=llm.Coulomb(0.3))]}
        if linear:
            self.problem = llm.ContactProblem(*forms, **options)
        else:
            F = [a - L for a, L in zip(*forms, strict=True)]
            self.problem = llm.NonlinearContactProblem(F, fields, **options)

    def step(self, k):
        """Step k, in one part or two; the parts that its history tells of, and calls."""
        calls = []
        if k % 3 == 0:
            self.moduli[0].value = 10.0 + 2.0 * np.sin(0.3 * k)
        self.loads[0].value = 0.1 + 0.05 * np.sin(0.17 * k)
        self.top.g.x.array[:] = 0.02 * np.sin(0.05 * k)
        increments = 1 + (k % 3 == 2)
        self.problem.solve(increments, accepted=calls.append)
        return increments, {entry["part"] for entry in self.problem.history}, len(calls)


@pytest.mark.parametrize("kind", ["linear", "nonlinear"])
@pytest.mark.parametrize("steps", [6, longer(200)])
def test_many_load_steps(kind, steps, tmp_path):
    """Memory stays; parts are counted; the last state is saved and goes on."""
    scene, sizes = Pressed(kind), []
    for k in range(steps):
        increments, parts, calls = scene.step(k)
        assert len(parts) >= increments and max(parts) == 1.0
        assert calls == 1 if kind == "linear" else increments <= calls <= len(parts)
        sizes.append(memory())
    if steps > 100:
        assert sizes[-1] - sizes[50] <= MOST * (steps - 50)
    scene.problem.save(tmp_path / "state.npz")
    again = Pressed(kind)
    for one, other in zip(again.moduli, scene.moduli, strict=True):
        one.value = other.value
    again.problem.load(tmp_path / "state.npz")
    for one in (scene, again):
        one.step(steps)
    forces = [one.problem.results[0].resultant for one in (scene, again)]
    np.testing.assert_allclose(forces[1], forces[0], rtol=1e-9)
    assert np.abs(forces[0]).max() > 0.05
