"""Laws of one's own against closed forms: in 2D and 3D, all forms, one and two ranks."""

import numpy as np
import own_law
import pytest
from conftest import run_mpi_json
from hertz2d import hold
from mpi4py import MPI
from sampling import drawn, longer

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.forms import choice

SCENES = {
    "glue": (own_law.Glue(), 0.0),
    "inclined": (own_law.Glue(), 30.0),
    "soft": (own_law.Soft(), 0.0),
}


def assert_known(rows):
    largest = max(abs(row["closed form"]) for row in rows)
    assert largest > 1.0
    for row in rows:
        assert abs(row["stress"] - row["closed form"]) <= 1e-11 * largest
        assert row["uneven"] <= 1e-10 * largest
        assert row["iterations"] <= 6


FORMS = ("flexibility", "saddle", "condensed")


@pytest.mark.parametrize("scene, dim, form", drawn(SCENES, (2, 3), FORMS, every=2))
def test_closed_form(scene, dim, form, monkeypatch):
    law, angle = SCENES[scene]
    monkeypatch.setattr(choice, "FLEXIBLE", 10**6 if form == "flexibility" else 0)
    solver = "saddle" if form == "flexibility" else form
    found, rows = own_law.run(law, dim, (4, 6) if dim == 2 else (3, 2), angle, solver)
    assert found == form
    assert_known(rows)


def assert_peeled(rows):
    """The crack grows, and its force is Griffith's but for shear and what gives way at the tip."""
    grows = [row for row in rows if row["parted"] > 0]
    assert len(grows) >= 4 and (np.diff([row["parted"] for row in rows]) >= 0).all()
    for row in grows:
        assert abs(row["force"] / row["Griffith"] - 1.0) <= 0.03


def test_peel():
    assert_peeled(own_law.peel())


def test_on_ranks():
    found = run_mpi_json("../../demos/own_law.py", 2, "--json", "--scenes", "inclined", "soft")
    assert_known(found["inclined"])
    assert_known(found["soft"])


class Layer(llm.Law):
    """Springs that neither part nor break, given by forces alone."""

    opens, slips, gives, closes_gap = False, True, True, False

    def force(self, nodes):
        k = 4000.0 * nodes.area[:, None] * np.ones(nodes.jump.shape)
        k[:, :-1] *= 0.5
        return k * nodes.jump, k


@pytest.mark.parametrize("solver", ["saddle", "condensed"])
def test_springs_that_do_not_part(solver):
    """Linear, to and fro: as the glue below its limit."""
    column = own_law.Column(Layer(), 2, (4, 6), 30.0, solver, slides=True)
    known, _ = own_law.stress_of(own_law.Glue(first=1.0, last=2.0), 0.004, 2, 30.0)
    for U, stress in ((0.004, known), (-0.004, -known)):
        row = column.pull(U)
        assert abs(row["stress"] - stress) <= 1e-11 * known and row["uneven"] <= 1e-10 * known
    side = column.problem.results[0].sides[0]
    assert (side.gap < 0.0).all() and (side.status == 1).all()


@pytest.mark.parametrize("dim, solver", [(2, "saddle"), (3, "condensed")])
def test_on_an_obstacle(dim, solver):
    """A soft layer on a rigid plane: pressed, lifted, pressed again."""
    domain, tags = own_law.block(MPI.COMM_WORLD, dim, 4, False, 0.0)
    V = compat.function_space(domain, shape=(dim,))
    top = hold(V, dim - 1, lambda x: np.isclose(x[dim - 1], 1.0))
    corner = [[0.0] * (dim - 1) + [1.0], [1.0] + [0.0] * (dim - 2) + [1.0]]
    at = [np.array([*c, *[0.0] * (3 - dim)]) for c in corner]
    bcs = [top, hold(V, 0, lambda x: own_law.near(x, at[0]))]
    bcs += [hold(V, 1, lambda x, a=a: own_law.near(x, a)) for a in at[: 2 * (dim - 2)]]
    plane = llm.RigidPlane((0.0,) * dim, (0.0,) * (dim - 1) + (1.0,))
    law = own_law.Soft()
    problem = own_law.problem([V], bcs, None, law, solver, llm.Interface(tags, (1, plane), law=law))
    for U in (-0.008, 0.001, -0.02):
        top.g.x.array[:] = U
        problem.solve()
        # Half as high as the column: the same stress for half the way, with half the overlap.
        known, _ = own_law.stress_of(own_law.Soft(h=2.0 * law.h), 2.0 * U, dim, 0.0)
        result = problem.results[0]
        assert np.abs(result.pressure + known).max() <= 1e-11 * 10.0
        assert (result.sides[0].gap < 0.0).all() == (U < 0.0)


@pytest.mark.parametrize("dim, solver", [(2, "condensed"), (3, "saddle")])
def test_supports_at_the_interface(dim, solver):
    """A quarter of the column: planes of symmetry hold nodes of both sides of the glue."""
    bodies = [own_law.block(MPI.COMM_WORLD, dim, n, n == 4, 0.0) for n in (3, 4)]
    spaces = [compat.function_space(domain, shape=(dim,)) for domain, _ in bodies]
    last = dim - 1
    top = hold(spaces[1], last, lambda x: np.isclose(x[last], 2.0))
    bcs = [top, hold(spaces[0], last, lambda x: np.isclose(x[last], 0.0))]
    bcs += [hold(V, k, lambda x, k=k: np.isclose(x[k], 0.0)) for V in spaces for k in range(last)]
    sides = (bodies[0][1], own_law.TOP), (bodies[1][1], own_law.BOTTOM)
    law = own_law.Glue()
    problem, largest = own_law.problem(spaces, bcs, sides, law, solver), 0.0
    for U in (0.004, 0.011, 0.005, 0.016, -0.003):
        top.g.x.array[:] = U
        problem.solve()
        known, largest = own_law.stress_of(law, U, dim, 0.0, largest)
        assert np.abs(problem.results[0].pressure + known).max() <= 1e-11 * 4.0


@pytest.mark.parametrize("limit", [longer(0), 10**6])
def test_beside_other_laws(limit, monkeypatch):
    """Glue, friction and a soft layer in series: one stress, and the sum of their jumps."""
    monkeypatch.setattr(choice, "FLEXIBLE", limit)
    bodies = [own_law.block(MPI.COMM_WORLD, 2, n, False, 0.0) for n in (3, 4, 3, 5)]
    for k, (domain, _) in enumerate(bodies):
        domain.geometry.x[:, 1] += k
    spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in bodies]
    top = hold(spaces[3], 1, lambda x: np.isclose(x[1], 4.0))
    bcs = [top, hold(spaces[0], 1, lambda x: np.isclose(x[1], 0.0))]
    bcs += [hold(V, 0, lambda x: np.isclose(x[0], 0.0)) for V in spaces]
    glue, soft = own_law.Glue(), own_law.Soft()
    touching = [
        llm.Interface(None, ((low[1], own_law.TOP), (high[1], own_law.BOTTOM)), law=law)
        for low, high, law in zip(bodies, bodies[1:], (glue, llm.Coulomb(0.3), soft), strict=False)
    ]
    problem = own_law.problem(spaces, bcs, None, None, "saddle", touching)
    top.g.x.array[:] = -0.03
    problem.solve()
    p = problem.results[0].pressure.mean()
    way = 4.0 * p * (1 - 0.09) / 1000.0 + p / glue.k + soft.h * np.log1p(p / soft.p0)
    assert abs(way - 0.03) <= 1e-12 * 0.03
    for result in problem.results:
        assert np.abs(result.pressure - p).max() <= 1e-10 * p


def test_closed_form_by_hand():
    """The glue's branches at hand values: compliance 2 (1 - ν²) / E = 0.00182 in 2D."""
    law, compliance = own_law.Glue(), 2.0 * (1 - 0.09) / 1000.0
    stress, _ = own_law.stress_of(law, 0.004, 2, 0.0)
    assert stress == pytest.approx(0.004 / (compliance + 1 / 4000.0))
    # Falling from 4 at 0.001 to 0 at 0.0145: s = 4 (0.0145 - Δ) / 0.0135, U = s C + Δ.
    slope = 4.0 / 0.0135
    opening = (0.011 - slope * compliance * 0.0145) / (1.0 - slope * compliance)
    stress, largest = own_law.stress_of(law, 0.011, 2, 0.0)
    assert largest == pytest.approx(opening) and stress == pytest.approx(slope * (0.0145 - opening))
    again, _ = own_law.stress_of(law, 0.005, 2, 0.0, largest)
    assert again == pytest.approx(stress * 0.005 / 0.011)
    assert np.isclose(own_law.stress_of(law, 0.02, 2, 0.0)[0], 0.0, atol=1e-12)
