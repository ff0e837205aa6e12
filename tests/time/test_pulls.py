"""A block that slides: friction slows it down by μ g, and by more where what pulls as it opens
makes friction too large, which is said."""

import logging
import re
from types import SimpleNamespace

import numpy as np
import pytest
import ufl
from dolfinx import fem
from friction_block import BOTTOM, body, stress
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.time.pulls import Pulls

COMM = MPI.COMM_SELF
MU, SPEED, G, RHO, E = 0.5, 0.6, 9.81, 1000.0, 1e7
SIZE, STEPS, DT = (0.2, 0.1), 20, 2e-3


def slowed(caplog, damping):
    """What it has lost of its speed, over μ g t, and the shares that are told."""
    domain, tags = body(COMM, (0.0, 0.0), SIZE, (8, 4))
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    a, L = ufl.inner(stress(u, E, 0.3), ufl.grad(w)) * ufl.dx, -RHO * G * w[1] * ufl.dx
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    interface = llm.Interface(tags, (BOTTOM, plane), law=llm.Coulomb(MU))
    s = llm.TimeStepper(RHO, a, L, dt=DT, interfaces=interface, damping=damping)
    s.v.interpolate(lambda x: np.stack([0.0 * x[0] + SPEED, 0.0 * x[0]]))
    caplog.clear()
    with caplog.at_level(logging.WARNING, logger="dolfinx_llm"):
        for _ in range(STEPS):
            s.step()
    momentum = fem.assemble_scalar(fem.form(s.density[0] * s.v[0] * ufl.dx))
    s.destroy()
    found = [re.search(r"pulled with ([\d.]+)%", r.getMessage()) for r in caplog.records]
    lost = SPEED - momentum / (RHO * SIZE[0] * SIZE[1])
    return lost / (MU * G * STEPS * DT), [float(one[1]) / 100.0 for one in found if one]


def test_friction_of_a_block_that_swings_is_told(caplog):
    lost, told = slowed(caplog, 0.0)
    assert len(told) >= 2 and np.all(np.diff(told) > 0.0)
    assert 0.05 < lost - 1.0 < 2.0 * told[-1]  # without a word before
    lost, told = slowed(caplog, 0.1)
    assert abs(lost - 1.0) < 0.02 and not told


def test_what_rounding_alone_has_touched_is_not_told():
    """Another interface, where the wave has not come to yet, had pulled with 26,450 %."""
    pressed, touched = Pulls("1 | 2"), Pulls("2 | 3")
    for now, noise in ((1.0, 1e-15), (2.0, -3e-15)):
        pressed.take([SimpleNamespace(pressing=np.array([now]))], 0.1)
        touched.take([SimpleNamespace(pressing=np.array([noise]))], 0.1)
    assert not touched.told(pressed.pressed, 0.0) and not pressed.told(pressed.pressed, 0.0)
    assert "300.0%" in touched.told(touched.pressed, 0.0)[0]


@pytest.mark.parametrize(("damping", "advice"), [(0.0, "give damping=0.1"), (0.1, "half a cell")])
def test_damping_is_not_advised_where_it_is(damping, advice):
    pulls = Pulls("1 | 2")
    for now in (1.0, -1.0):
        pulls.take([SimpleNamespace(pressing=np.array([now]))], 0.1)
    (told,) = pulls.told(pulls.pressed, damping)
    assert advice in told
