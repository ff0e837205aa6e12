"""What is changed between two load steps at finite deformation counts in the second."""

from dataclasses import replace

import finite_patch
import numpy as np
import pytest
from conftest import run_mpi_json
from pressed_scenes import Punch
from sampling import longer

import dolfinx_llm as llm


@pytest.mark.parametrize("factor", [longer(1e-6), longer(1e-9), 1e9])
def test_moduli(factor):
    """Where motions are prescribed forces are as many times as large, with as many iterations: it
    took hundreds, or failed."""
    moduli = []

    def energy(u, *lame):
        moduli.extend(lame)
        return finite_patch.energy(u, *lame)

    forces, iterations = [], []
    for times in (1.0, factor):
        moduli.clear()
        punch = Punch(law=llm.Coulomb(0.3), energy=energy)
        punch.to(1e-6)
        for modulus in moduli:
            modulus.value *= times
        punch.problem.reset()  # without the forces that there were
        forces.append(punch.to(0.03, 0.01).resultant / times)
        iterations.append(len(punch.problem.history))
    assert np.allclose(*forces, rtol=1e-9)
    assert iterations[1] <= iterations[0] + 1


def test_interfaces_stay():
    """Another law asks for another problem: what took the place of one was ignored."""
    (interface,) = (problem := Punch(law=llm.Coulomb(0.3)).problem).interfaces
    with pytest.raises(TypeError, match="item assignment"):
        problem.interfaces[0] = replace(interface, law=llm.Tied())


def test_a_mesh_that_was_moved():
    """A punch that is drawn deeper is pressed as one that is moved there, and slides from there."""
    drawn, moved = (Punch(law=llm.Coulomb(0.3)) for _ in range(2))
    drawn.to(0.01)
    x = drawn.u[1].function_space.mesh.geometry.x
    x[:, 1] -= 0.02
    drawn.u[1].x.array[:] = drawn.u[0].x.array[:] = 0.0
    for along in (0.0, 0.01, 0.1):
        found = drawn.to(0.01, along).resultant
        known = moved.to(0.03, along).resultant
        assert np.allclose(found, known, rtol=1e-8)
    assert len(drawn.problem.history) == len(moved.problem.history)
    assert np.abs(drawn.u[1].x.array[1::2].min() + 0.01) < 1e-9
    x[0, 0] = np.nan
    for _ in range(2):
        with pytest.raises(llm.ContactInputError, match="positions of 1 node"):
            drawn.problem.solve()


def test_u_set_after_a_reset():
    """It is where the next step starts; that was refused, with the advice to call ``reset``."""
    found = []
    for first in (False, True):
        punch = Punch(law=llm.Coulomb(0.3))
        with pytest.raises(llm.ContactError, match="no results yet: call solve"):
            punch.problem.results[0]
        if first:
            punch.to(0.02, 0.01)
            punch.problem.reset()
            for u in punch.u:
                u.x.array[:] = 0.0
        found.append(punch.to(0.01).resultant)
    assert np.allclose(*found, rtol=1e-9)


@pytest.mark.parametrize(
    ("law", "solver", "ranks"),
    [("tied", "saddle", 1), ("friction", "condensed", 2), longer("friction", "saddle", 1),
     longer("tied", "condensed", 2)],
)  # fmt: skip
def test_supports_that_go(law, solver, ranks):
    """A punch is pressed and dragged, let go along the surface, and taken back: supports that have
    gone bear nothing, and what does not slip knows no way. It was refused."""
    found = run_mpi_json("held_anew.py", ranks, law, solver)
    assert found["dragged"] > 0.05 and found["place"] < 0.01
    assert max(found["free"], found["again"]) <= 1e-12, found
    assert max(found["known"], found["back"]) <= (1e-12 if law == "tied" else 1e-6), found
