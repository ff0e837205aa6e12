"""Which side is named first changes nothing but signs, on curved surfaces as well, whose areas are
those of both sides."""

import curved_scenes as cs
import numpy as np
import pytest
import scenes
import second_order_blocks as so
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

COUNTS = ((7, 2), (5, 2))  # cells along each ring and across it


class Glue(llm.Law):
    """Springs along the normal and across it."""

    opens, slips, gives = False, True, True

    def force(self, nodes):
        k = 1e4 * nodes.area[:, None]
        return k * nodes.jump, k * np.ones_like(nodes.jump)


def told(result, sign):
    """What a result says at the frame's nodes, sorted by position, as of sides in their order."""
    order = np.lexsort(result.x.round(9).T)
    found = result.pressure, result.frame_area, result.frame_force, sign * result.traction
    return [a[order] for a in found]


def compare(found):
    """Displacements, and what results say, for both orders."""
    for a, b in zip(*found, strict=True):
        assert np.abs(a - b).max() <= 1e-11 * np.abs(a).max() + 1e-300


def widened(p):
    """The inner ring's bore grows and turns; the outer ring's rim stays."""
    inner = np.hypot(p[0], p[1]) < 1.2
    return inner * np.array([0.01 * p[0] - 0.03 * p[1], 0.01 * p[1] + 0.03 * p[0]])


@pytest.mark.parametrize(
    "law",
    [llm.Tied(), llm.Tied(close_gap=True), llm.Frictionless(), llm.Coulomb(0.1, cohesion=5.0),
     Glue()],
    ids=lambda law: repr(law),
)  # fmt: skip
def test_curved(law):
    V, tags = cs.rings(MPI.COMM_SELF, COUNTS)
    ends = [lambda p, r=r: np.isclose(np.hypot(p[0], p[1]), r) for r in (1.0, 2.0)]
    conditions = [(k, where) for k in (0, 1) for where in ends]
    found = []
    for sides, sign in (((cs.FACE_0, cs.FACE_1), 1.0), ((cs.FACE_1, cs.FACE_0), -1.0)):
        problem = cs.ring_problem(V, tags, conditions, widened, law=law, sides=sides)
        u = problem.solve().x.array.copy()
        result = problem.results[0]
        found.append([u, *told(result, sign)])
        assert all(np.array_equal(side.X, side.drawn) for side in result.sides)
    assert found[0][1].max() > 1.0
    compare(found)


@pytest.mark.parametrize("law", [llm.Tied(), llm.Conductance(0.5)], ids=repr)
def test_heat_along_a_curve(law):
    """Bore and rim at 1 and 0: what flows is told at all nodes alike, and adds up."""
    V, tags = cs.rings(MPI.COMM_SELF, COUNTS)
    T = compat.function_space(V.mesh)
    u, w = ufl.TrialFunction(T), ufl.TestFunction(T)
    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(T, 1, tags.find(tag)), T)
        for tag, value in ((cs.BORE, 1.0), (cs.RIM, 0.0))
    ]
    found = []
    for sides in ((cs.FACE_0, cs.FACE_1), (cs.FACE_1, cs.FACE_0)):
        problem = llm.ContactProblem(
            ufl.inner(ufl.grad(u), ufl.grad(w)) * ufl.dx,
            fem.Constant(V.mesh, 0.0) * w * ufl.dx,
            bcs=bcs,
            interfaces=llm.Interface(tags, sides, law=law),
        )
        temperature, result = problem.solve().x.array.copy(), problem.results[0]
        flux = result.flux[np.lexsort(result.x.round(9).T)]
        found.append([temperature, np.abs(flux), np.abs(result.resultant)])
        assert flux @ result.frame_area[np.lexsort(result.x.round(9).T)] == pytest.approx(
            result.resultant[0], rel=1e-12
        )
    compare(found)
    resistance = np.log(1.5) + np.log(2.0 / 1.5) + (0.0 if law.ties else 1.0 / (0.5 * 1.5))
    assert found[0][2][0] == pytest.approx(0.5 * np.pi / resistance, rel=0.01)


@pytest.mark.parametrize("law", [llm.Tied(), llm.Frictionless()], ids=repr)
def test_second_order_with_as_many_nodes(law):
    """Both sides are as fine, and their nodes lie elsewhere."""
    spaces, tags = so.blocks(
        MPI.COMM_SELF, ("triangle", "triangle"), (4, 4), ((0, 0), (0, 1)), ((1, 1), (1, 2))
    )
    (V,), (own,) = spaces, tags
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    x, ds = ufl.SpatialCoordinate(V.mesh), ufl.Measure("ds", domain=V.mesh, subdomain_data=own)
    planes = [(0, scenes.on(1, 0.0)), (1, scenes.on(1, 0.0)), (0, scenes.on(1, 2.0))]
    found = []
    for sides, sign in (((2, 3), 1.0), ((3, 2), -1.0)):
        problem = llm.ContactProblem(
            ufl.inner(so.stress(u), ufl.grad(w)) * ufl.dx,
            -(1.0 + x[0] ** 2) * w[1] * ds(so.TOP[1]),
            bcs=scenes.hold(V, planes),
            interfaces=llm.Interface(own, sides, law=law),
        )
        values = problem.solve().x.array.copy()
        pressure, _, force, traction = told(problem.results[0], sign)
        found.append([values, pressure, force, traction])
    a, b = problem.results[0].sides
    assert len(a.x) == len(b.x) and np.abs(a.x - b.x).max() > 0.01
    compare(found)


def test_rim_of_a_regular_mesh():
    """Nodes beyond the rim have two neighbours alike, of which one speaks for them."""
    sections = scenes.grid(3, 3), scenes.grid(4, 4, (0.1, 0.1), (0.9, 0.9))
    domain, tags = scenes.stacked(MPI.COMM_SELF, sections, (0.0, 1.0, 2.0))
    V, found = compat.function_space(domain, shape=(3,)), []
    ends = [(k, scenes.on(2, z)) for z in (0.0, 2.0) for k in range(3)]
    bcs = scenes.hold(V, ends, lambda p: np.outer([0.002, 0.002, -0.02], p[2] > 1.0))
    for sides, sign in (((2, 3), 1.0), ((3, 2), -1.0)):
        interface = llm.Interface(tags, sides, law=llm.Coulomb(0.15))
        problem = scenes.elastic_problem([V], bcs, [interface])
        values = problem.solve()[0].x.array.copy()
        found.append([values, *told(problem.results[0], sign)])
    compare(found)
