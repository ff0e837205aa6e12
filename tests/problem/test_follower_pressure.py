"""A pressure that follows a surface: what covers it comes and goes; facets that bend."""

import bent_rings
import finite_patch
import numpy as np
import pytest
import test_finite_deformation as fd
import ufl
from dolfinx import fem
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

P = 50.0


def covered(cells, p=P):
    """A block under pressure where another one, held at its top, leaves it free; and its motion."""
    domain, tags = fd.blocks(cells, (1.0, 0.6), shift=0.17)
    V, u, F = fd.bodies_of(domain)
    down = fem.Constant(domain, 0.0)
    held = []
    for tag, value in ((fd.BOTTOM, (0.0, 0.0)), (fd.TOP, (0.0, down))):
        for k in (0, 1):
            dofs = fem.locate_dofs_topological(V.sub(k), 1, tags.indices[tags.values == tag])
            held.append(fem.dirichletbc(value[k], dofs, V.sub(k)))
    load = llm.FreeSurfacePressure(tags, fd.LOW, p, covered_by=(tags, fd.HIGH))
    interface = llm.Interface(tags, (fd.LOW, fd.HIGH), law=llm.Frictionless())
    problem = llm.NonlinearContactProblem(F, u, bcs=held, interfaces=[interface], loads=[load])
    return problem, u, down


@pytest.mark.parametrize("cells", [longer((6, 8)), (9, 4)])
def test_cover_arrives_and_leaves_in_one_step(cells):
    """Lifted at once the surface bears all of the pressure, whose resultant follows from where it
    ends; put back at once the state is that of a cover that never left. Solving again changes
    nothing."""
    problem, u, down = covered(cells)
    states = []
    for motion in (-0.04, 0.6, -0.04):
        down.value = motion
        for _ in range(2):
            problem.solve()
            states.append(u.x.array.copy())
        assert len(problem.history) == 1
        if motion > 0.0:
            x = u.function_space.tabulate_dof_coordinates()[:, :2]
            lower = x[:, 1] <= 1.0 + 1e-12
            ends = [
                np.flatnonzero(np.linalg.norm(x - at, axis=1) < 1e-9) for at in ([0, 1], [1, 1])
            ]
            ends = [e[0] for e in ends]
            chord = (x + u.x.array.reshape(x.shape))[ends]
            side = chord[1] - chord[0]
            force = problem.pushed.reshape(x.shape)[lower].sum(axis=0)
            assert np.abs(force - P * np.array([side[1], -side[0]])).max() < 1e-10 * P
    for again in (1, 3, 5):
        assert np.abs(states[again] - states[again - 1]).max() < 1e-10
    assert np.abs(states[4] - states[0]).max() < 1e-10


@pytest.mark.parametrize("gap", [longer(0.16), 0.2])
def test_surface_that_is_pulled_to_its_cover(gap):
    """A suction that draws it so near that it is covered, and without which it is not: no state is
    both. The step ends, and ends in the same state again."""
    problem, u, down = covered((6, 8), -100.0)
    down.value = gap
    problem.solve()
    found = u.x.array.copy()
    problem.solve()
    assert len({h["part"] for h in problem.history}) == 1
    assert np.abs(u.x.array - found).max() < 1e-10


@pytest.mark.parametrize("gdim", [2, longer(3)])
def test_bore_of_second_order(gdim):
    """Under pressure it is in equilibrium with UFL's own load on the boundary as it bends."""
    domain, tags = bent_rings.ring(8, 0.5, 1.0, 0.0, layers=gdim - 2)
    V, p = compat.function_space(domain, degree=2, shape=(gdim,)), 60.0
    u, v = fem.Function(V), ufl.TestFunction(V)
    F = finite_patch.residual(u, *finite_patch.lame(100.0, 0.3), 2)
    outer = fem.locate_dofs_topological(V, gdim - 1, tags.indices[tags.values == 2])
    zero = fem.Function(V)
    bcs = [fem.dirichletbc(zero, outer)]
    loads = [llm.FreeSurfacePressure(tags, 1, p)]
    llm.NonlinearContactProblem(F, u, bcs=bcs, loads=loads).solve(increments=2)
    grown, n = ufl.Identity(gdim) + ufl.grad(u), ufl.FacetNormal(domain)
    ds = ufl.Measure("ds", domain=domain, subdomain_data=tags, metadata={"quadrature_degree": 8})
    push = p * ufl.inner(ufl.det(grown) * ufl.inv(grown).T * n, v) * ds(1)
    left, whole = (fem.petsc.assemble_vector(fem.form(form)).array for form in (F + push, push))
    left.reshape(-1, gdim)[outer] = 0.0
    assert np.abs(u.x.array).max() > 0.05
    assert np.abs(left).max() < 1e-9 * np.abs(whole).max()
