"""Opposite sides of one body tied at a distance: periodic cells, whose meshes do not match."""

import numpy as np
import pytest
import ufl
from conftest import run_mpi_json
from contact_scenes import rectangle
from dolfinx import fem
from mpi4py import MPI
from periodic_cells import NU, E, cell

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM, STIFFER = MPI.COMM_SELF, 7.0
LONG = pytest.mark.long


@pytest.mark.parametrize(
    ("gdim", "kind", "solver", "degree"),
    [
        (2, "triangle", "saddle", 1),
        (2, "quadrilateral", "condensed", 1),
        pytest.param(2, "triangle", "saddle", 2, marks=LONG),
        pytest.param(3, "hexahedron", "saddle", 1, marks=LONG),
        pytest.param(3, "tetrahedron", "condensed", 1, marks=LONG),
    ],
)
def test_constant_stress(gdim, kind, solver, degree):
    """A homogeneous cell under any mean strain: nothing is left to move."""
    problem, _, mean, _ = cell(COMM, gdim, kind, 4, llm.Tied(), degree=degree, solver=solver)
    mean.value[:] = np.random.default_rng(7).normal(size=(gdim, gdim))
    u = problem.solve()
    assert np.abs(u.x.array).max() < 1e-12
    x = problem.results[0].sides[1].x  # as drawn
    assert np.allclose(x[:, 0], 1.0)


@pytest.mark.parametrize("scalar", [False, True])
def test_laminate(scalar):
    """Stress across layers of two materials: harmonic mean of the moduli, in every cell."""
    problem, modulus, mean, flux = cell(COMM, 2, "quadrilateral", 8, llm.Tied(), False, scalar)
    x = modulus.function_space.tabulate_dof_coordinates()
    modulus.x.array[x[:, 0] > 0.5] = STIFFER * E
    mean.value[(0,) if scalar else (0, 0)] = 0.01
    u = problem.solve()
    across = flux(ufl.grad(u) + mean)[(0,) if scalar else (0, 0)]
    wave = 1.0 if scalar else (1 - NU) / (1 + NU) / (1 - 2 * NU)
    exact = 0.01 * wave * 2.0 / (1.0 / E + 1.0 / (STIFFER * E))
    off = fem.assemble_scalar(fem.form((across / exact - 1.0) ** 2 * ufl.dx))
    assert off**0.5 < 1e-11


def test_refused():
    """Shifts of what is not tied, of other dimensions, to nowhere."""
    with pytest.raises(llm.ContactInputError, match="two sides that are tied may lie apart"):
        cell(COMM, 2, "triangle", 2, llm.Frictionless())
    domain, tags = rectangle(COMM, (2, 2), (0.0, 0.0), (1.0, 1.0), "triangle")
    with pytest.raises(llm.ContactInputError, match="shift=.*give a vector"):
        llm.Interface(tags, (1, 2), shift="right")
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    a = ufl.inner(ufl.grad(u), ufl.grad(w)) * ufl.dx
    L = ufl.inner(fem.Constant(domain, (0.0, 0.0)), w) * ufl.dx
    for shift, words in (((1.0,), "as many numbers"), ((0.0, 3.0), "do not overlap|no facet|face")):
        with pytest.raises(llm.ContactError, match=words):
            llm.ContactProblem(a, L, interfaces=llm.Interface(tags, (1, 2), shift=shift))


@pytest.mark.long
def test_ranks():
    """Nothing is left to move on three ranks either."""
    assert max(run_mpi_json("periodic_ranks.py", 3)["moved"]) < 1e-12
