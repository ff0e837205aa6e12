"""Steps in time that fail after a part of them was found, and bodies of which some ranks have
nothing."""

import numpy as np
import pytest
import ufl
from conftest import run_mpi_json
from dolfinx import fem
from friction_block import BOTTOM, body, stress
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.finite.failures import StepFailed
from dolfinx_llm.finite.newton import NewtonSteps

COMM = MPI.COMM_SELF


def test_nothing_is_left_of_a_step_that_fails(monkeypatch):
    """A block slides over a plane that does not stop it: friction is μ N at the end of every step,
    also of the halves of one that failed after nine tenths of it had been found. The first half
    went on from there, and had 4 % less friction."""
    domain, tags = body(COMM, (0.0, 0.0), (1.0, 1.0), (3, 5))
    V = compat.function_space(domain, shape=(2,))
    u, w = fem.Function(V), ufl.TestFunction(V)
    weight = fem.Constant(domain, (0.0, -20.0))
    F = ufl.inner(stress(u, 1e3, 0.3), ufl.grad(w)) * ufl.dx - ufl.inner(weight, w) * ufl.dx
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    interfaces = llm.Interface(tags, (BOTTOM, plane), law=llm.Coulomb(0.3))
    slopes, lengths, increment = [], [], NewtonSteps._increment

    def accepted(s):
        along, down = s.problem.results[0].resultant
        slopes.append(abs(along / down))

    def failing(newton, step, end, bar):
        """The second step, as a whole, fails beyond nine tenths."""
        if len(lengths) == 2 and end > 0.9:
            raise StepFailed("beyond nine tenths")
        return increment(newton, step, end, bar)

    monkeypatch.setattr(NewtonSteps, "_increment", failing)
    s = llm.TimeStepper(1.0, F, u, dt=0.01, interfaces=interfaces, accepted=accepted)
    s.v.interpolate(lambda x: np.stack([1.0 + 0.0 * x[0], 0.0 * x[0]]))
    once = s._once
    s._once = lambda dt, part: (lengths.append(dt), once(dt, part))
    s.step()
    s.step()
    assert np.allclose(lengths, (0.01, 0.01, 0.005, 0.005))
    assert np.allclose(slopes, 0.3, rtol=1e-9), slopes


@pytest.mark.parametrize(
    ("scene", "along", "friction"),
    [("sliding", 0.9, 0.0), longer("flying", 0.9, 0.0), longer("pressed", None, 6.0)],
)
def test_ranks_without_dofs(scene, along, friction):
    """All come to the same: without friction a load along the plane speeds bodies up by its
    acceleration times the time, 0.3. Velocities of nonlinear bodies, and multigrid's rigid motions,
    were shaped by numbers of dofs, and a rank without any left the others waiting."""
    found = run_mpi_json("idle_ranks.py", 2, scene, seconds=60)
    assert found["idle"] == 1
    assert along is None or abs(found["along"] - along) <= 1e-12
    assert abs(found["friction"] - friction) <= 1e-9
