"""A sector of a press fit between planes of symmetry, against Lamé: shallow surfaces that follow
each other, whose facets' heights are many times the overlap."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

pytestmark = pytest.mark.quick
E, NU, R, OVERLAP = 1000.0, 0.3, 2.0, 1e-3


def ring(inner, outer, angle, around):
    """A sector of quadrilaterals: forms, tags 1 and 2 of the inner and outer face, 3 and 4 of the
    planes of symmetry at 0 and the angle, and the condition at 0."""
    domain = dmesh.create_rectangle(
        MPI.COMM_SELF, [(inner, 0.0), (outer, angle)], [4, around], dmesh.CellType.quadrilateral
    )
    at = [(0, inner), (0, outer), (1, 0.0), (1, angle)]
    facets = [
        dmesh.locate_entities_boundary(domain, 1, lambda x, k=k, c=c: np.isclose(x[k], c))
        for k, c in at
    ]
    values = np.repeat(np.arange(1, 5), [len(f) for f in facets]).astype(np.int32)
    facets = np.concatenate(facets)
    order = np.argsort(facets)
    tags = dmesh.meshtags(domain, 1, facets[order], values[order])
    r, t = domain.geometry.x[:, 0].copy(), domain.geometry.x[:, 1].copy()
    domain.geometry.x[:, 0], domain.geometry.x[:, 1] = r * np.cos(t), r * np.sin(t)
    V = compat.function_space(domain, shape=(2,))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    strain = ufl.sym(ufl.grad(u))
    sigma = E / (1 + NU) * (strain + NU / (1 - 2 * NU) * ufl.tr(strain) * ufl.Identity(2))
    a = ufl.inner(sigma, ufl.grad(v)) * ufl.dx
    L = ufl.inner(fem.Constant(domain, (0.0, 0.0)), v) * ufl.dx
    rest = fem.locate_dofs_topological(V.sub(1), 1, tags.find(3))
    return a, L, tags, fem.dirichletbc(fem.Constant(domain, 0.0), rest, V.sub(1))


@pytest.mark.parametrize("degrees, around", [(12, (2, 3)), (20, (3, 4)), (30, (4, 6))])
def test_pressure_of_a_sector(degrees, around):
    """Facets' heights are no gaps: pressures were up to 26 times Lamé's where nodes met."""
    angle = np.radians(degrees)
    bodies = [ring(1.0, R + OVERLAP, angle, around[0]), ring(R, 3.0, angle, around[1])]
    a, L, tags, bcs = zip(*bodies, strict=True)
    interfaces = [llm.Interface(None, ((tags[0], 2), (tags[1], 1)), law=llm.Frictionless())]
    normal = (np.sin(angle), -np.cos(angle))
    for own in tags:
        plane = llm.RigidPlane((0.0, 0.0), normal)
        interfaces.append(llm.Interface(own, (4, plane), law=llm.Sliding()))
    with llm.ContactProblem(a, L, bcs=bcs, interfaces=interfaces) as problem:
        problem.solve()
        pressure = problem.results[0].pressure
    lame = E / (1 - NU**2) * OVERLAP / R * (9 - R**2) * (R**2 - 1) / (2 * R**2 * (9 - 1))
    assert np.abs(pressure / lame - 1.0).max() < 0.05


@pytest.mark.parametrize("swapped", [False, True])
def test_rings_that_part(swapped):
    """Chords of the outer one lie in the nodes of the inner one, which said that they come nearer
    where the outer one grows; gaps that meshes tell mean nothing where nothing moves."""
    bodies = [ring(1.0, R, np.pi / 2, 8), ring(R + 0.005, 3.0, np.pi / 2, 5)]
    a, L, tags, bcs = zip(*bodies, strict=True)
    V = [form.arguments()[0].ufl_function_space() for form in a]
    grown = fem.Function(V[1])
    held = list(bcs)
    for space, own, tag in ((V[0], tags[0], 1), (V[1], tags[1], 2)):
        motion = grown if tag == 2 else fem.Function(space)
        held.append(fem.dirichletbc(motion, fem.locate_dofs_topological(space, 1, own.find(tag))))
    sides = ((tags[0], 2), (tags[1], 1))
    parted = llm.Interface(None, sides[::-1] if swapped else sides, law=llm.Frictionless())
    with llm.ContactProblem(a, L, bcs=held, interfaces=[parted]) as problem:
        for part in (0.0, 0.01):
            grown.interpolate(lambda x, part=part: part * x[:2])
            problem.solve()
            assert not problem.results[0].sides[0].force.any()
            assert "nothing touches" not in str(problem) and "meshes tell" not in str(problem)
