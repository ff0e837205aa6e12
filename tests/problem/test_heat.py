"""Heat across interfaces: known temperatures on meshes that do not match, in all forms."""

import heat_scenes as heat
import numpy as np
import pytest
import ufl
from conftest import run_mpi_json
from dolfinx import fem
from mpi4py import MPI
from sampling import longer, some_of

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.output.bodies import checked_view

COMM, H = MPI.COMM_SELF, 2.5
FORMS = "saddle", "condensed", "flexibility"


def check(scene):
    """The temperature, and what flows: out of one body, into the other."""
    u, result = scene.problem.solve(), scene.problem.results[0]
    assert scene.error() <= 1e-12
    assert result.flux == pytest.approx(heat.FLUX * np.sign(result.resultant[0]), rel=1e-10)
    total = result.sides[0].force.sum()
    assert abs(total + result.sides[1].force.sum()) <= 1e-11 * abs(total)
    assert result.resultant == pytest.approx([total])
    return u, result


@pytest.mark.parametrize(
    ("gdim", "law", "solver", "sides", "degree"),
    some_of(
        [
            (gdim, law, solver, sides, degree)
            for gdim in (2, 3)
            for law in ("tied", "finite", "varying")
            for solver in ("auto", "saddle", "condensed")
            for sides in (False, True)
            for degree in (1, 2)
            if degree == 1 or law != "tied"  # whose tests are below
        ],
        [
            (2, "tied", "saddle", False, 1),
            (2, "varying", "condensed", True, 2),
            (3, "finite", "condensed", True, 1),
            (3, "finite", "auto", False, 2),
        ],
    ),
)
def test_linear_temperature(gdim, law, solver, sides, degree):
    """Continuous, with a jump q / h, and with one that grows along the surface as 1 / h does."""
    jump, slope = {"tied": (0.0, 0.0), "finite": (heat.FLUX / H, 0.0), "varying": (0.4, 0.3)}[law]
    field = heat.Linear(gdim, jump, slope)
    made = {"tied": llm.Tied(), "finite": llm.Conductance(H)}
    bodies = heat.blocks(COMM, gdim)
    for order in ((0, 1), (1, 0)):
        chosen = made.get(law, llm.Conductance(field.conductance))
        scene = heat.Conducting(bodies, chosen, field, sides, degree, order, solver=solver)
        check(scene)


@pytest.mark.parametrize("solver", ["saddle", "condensed"])
def test_second_order_tied(solver):
    """A quadratic temperature, whose flux is linear along the interface."""
    bodies = heat.blocks(COMM, 2)
    scene = heat.Conducting(bodies, llm.Tied(), heat.Quadratic(), degree=2, solver=solver)
    scene.problem.solve()
    assert scene.error() <= 1e-12
    result = scene.problem.results[0]
    assert result.flux == pytest.approx(heat.FLUX * result.x[:, 0], abs=1e-10)
    between = np.array([[0.1, 1.0], [0.77, 1.01], [1.5, 1.0]])  # the last one beyond its end
    expected = heat.FLUX * np.array([0.1, 0.77, 1.0])
    assert result.pressure_at(between) == pytest.approx(expected, abs=1e-10)


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("solver", ["saddle", longer("condensed")])
@pytest.mark.parametrize("h", [H, np.inf], ids=["resists", "tied"])
def test_flux_at_a_cross(degree, solver, h):
    """Four blocks: what flows is the same at all nodes of four interfaces, at that where they meet
    as well."""
    law = llm.Conductance(H) if h == H else llm.Tied()
    problem, known = heat.cross(COMM, law, h, degree, solver)
    for u, temperature in zip(problem.solve(), known, strict=True):
        x = u.function_space.tabulate_dof_coordinates().T
        assert np.abs(u.x.array - temperature(x)).max() <= 1e-12
    for i, result in enumerate(problem.results):
        assert np.abs(result.flux - heat.THROUGH[i // 2]).max() <= 1e-12
        assert abs(sum(side.force.sum() for side in result.sides)) <= 1e-12
        assert np.abs(result.x - 1.0).max(axis=1).min() <= 1e-12


@pytest.mark.long
def test_curved_of_second_order():
    """Tubes in each other: the heat that flows, against that of concentric circles."""
    off = [heat.tubes(n, H) for n in (16, 32)]
    assert off[1][0] <= off[0][0] / 8.0 <= 2e-5
    assert off[1][1] <= off[0][1] / 4.0 <= 1e-3


def outflow(scene, i):
    """What flows out of a body, by K u of all its nodes: into what prescribes its temperature."""
    V, u = scene.spaces[i], scene.problem.u[i]
    form = compat.form("a", ufl.action(scene.forms[i], u))
    force = compat.assemble_force((form,), (1.0,), V)
    return force[np.isclose(V.tabulate_dof_coordinates()[: len(force), 1], 2.0 * i)].sum()


def test_flow_through_a_part():
    """The upper block is narrower: what flows through its top flows through the interface, and
    through the other one's bottom; anew for another conductance."""
    h = [0.5]
    law = llm.Conductance(lambda x: np.full(len(x), h[0]))
    scene, flows = heat.Conducting(heat.blocks(COMM, 2, narrow=0.23), law, heat.Ends()), []
    for h[0] in (0.5, 5.0, 0.0):
        scene.problem.solve()
        flows.append(scene.problem.results[0].resultant[0])
        for i in (0, 1):
            assert (1 - 2 * i) * outflow(scene, i) == pytest.approx(flows[-1], rel=1e-11, abs=1e-12)
    assert abs(flows[2]) < 1e-15 < flows[0] < flows[1]
    with pytest.raises(llm.ContactInputError, match="scalar field has none"):
        scene.problem.results[0].moment()


def test_conductance_as_constant_or_function():
    """Both change between solves."""
    bodies = heat.blocks(COMM, 2)
    constant = fem.Constant(bodies[0][0], H)
    function = fem.Function(compat.function_space(bodies[1][0]))
    for h in (constant, function):
        scene = heat.Conducting(bodies, llm.Conductance(h), heat.Linear(2))
        for now in (H, 3.0 * H):
            if h is constant:
                constant.value = now
            else:
                function.x.array[:] = now
            scene.bcs[1].g.x.array[:] += scene.field.jump - heat.FLUX / now
            scene.field.jump = heat.FLUX / now
            check(scene)
    with pytest.raises(llm.ContactInputError, match="a finite number of at least 0"):
        llm.Conductance(fem.Constant(bodies[0][0], -1.0))


@pytest.mark.parametrize("law", [llm.Tied(), llm.Conductance(H)], ids=str)
def test_heated_body(law):
    """A body that only the interface cools: all of its heat goes there."""
    bodies = heat.blocks(COMM, 2)
    scene = heat.Conducting(bodies, law, heat.Ends(), held=(0,))
    scene.sources[1].value = 0.7
    scene.problem.solve()
    assert scene.problem.results[0].resultant == pytest.approx([-0.7], rel=1e-10)
    assert outflow(scene, 0) == pytest.approx(-0.7, rel=1e-10)
    with pytest.raises(llm.ContactError, match="known but for a constant"):
        heat.Conducting(bodies, law, heat.Ends(), held=())
    if not law.ties:
        scene = heat.Conducting(bodies, llm.Conductance(0.0), heat.Ends(), held=(0,))
        scene.sources[1].value = 0.7
        with pytest.raises(llm.ContactError, match="do not balance the load.*flow into it 0.7"):
            scene.problem.solve()


class Cubic(llm.Law):
    """q = h (jump + b jump³)."""

    components, opens, gives, closes_gap, scalar = "cartesian", False, True, False, True

    def force(self, nodes):
        k, jump = H * nodes.area[:, None], nodes.jump
        return k * (jump + 0.7 * jump**3), k * (1.0 + 2.1 * jump**2)


@pytest.mark.parametrize("solver", ["auto", longer("condensed")])
def test_own_law(solver):
    """A conductance that grows with the jump; and twice in a row."""
    jump = np.real(np.roots([0.7, 0.0, 1.0, -heat.FLUX / H])[-1])
    scene = heat.Conducting(heat.blocks(COMM, 2), Cubic(), heat.Linear(2, jump), solver=solver)
    check(scene)
    check(scene)


@pytest.mark.parametrize("law", [llm.Tied(), llm.Conductance(H)], ids=str)
def test_adjoint(law):
    """dJ of a load, against a second solve: the problem is linear."""
    scene = heat.Conducting(heat.blocks(COMM, 2), law, heat.Linear(2))
    u = scene.problem.solve()
    tests = [ufl.TestFunction(V) for V in scene.spaces]
    x = [ufl.SpatialCoordinate(V.mesh) for V in scene.spaces]
    p = scene.problem.adjoint([y[0] * v * ufl.dx for y, v in zip(x, tests)])
    more = [load + 3.0 * y[1] * v * ufl.dx for load, y, v in zip(scene.loads, x, tests)]
    other = llm.ContactProblem(scene.forms, more, bcs=scene.bcs, interfaces=scene.interface).solve()
    moved = [y[0] * (b - a) * ufl.dx for y, a, b in zip(x, u, other)]
    change = sum(fem.assemble_scalar(fem.form(form)) for form in moved)
    told = sum(fem.assemble_scalar(fem.form(3.0 * y[1] * q * ufl.dx)) for y, q in zip(x, p))
    assert told == pytest.approx(change, rel=1e-9)


def test_files_and_pictures(tmp_path):
    """Values at nodes by their own names; nothing is drawn as moved."""
    scene = heat.Conducting(heat.blocks(COMM, 2), llm.Tied(), heat.Linear(2))
    scene.problem.solve()
    parts = llm.post.interface_fields(scene.problem.results[0])
    assert set(parts["frame"][2]) == {"u", "flux", "area"}
    assert set(parts["side_1"][2]) == {"u", "flow", "area"}
    x, _, fields = parts["side_0"]
    assert fields["u"] == pytest.approx(scene.field(0, x.T))
    llm.post.write_interface(tmp_path, scene.problem.results[0])
    llm.post.write_bodies(tmp_path / "bodies.pvd", scene.problem.u[1])
    for name, label in (("displacement", "u ("), ("pressure", "flux (")):
        scene.problem.plot(tmp_path, colour=name)
        seen = checked_view(name, None, None, 2).seen(COMM, scene.problem.u, scene.problem.results)
        shown = seen.scene().label
        assert shown.startswith(label) and shown.endswith(")")
    assert (tmp_path / "bodies.png").stat().st_size > 5000
    scene.problem.save(tmp_path / "state.npz")
    before = [u.x.array.copy() for u in scene.problem.u]
    scene.problem.load(tmp_path / "state.npz")
    for u, known in zip(scene.problem.u, before):
        assert u.x.array == pytest.approx(known, rel=1e-14)


@pytest.mark.long
@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks(ranks):
    """Patch tests in 2D and 3D, in all forms."""
    data = run_mpi_json("heat_ranks.py", ranks)
    assert len(data) == 8
    assert max(data.values()) <= 1e-12


def test_what_is_refused():
    """Laws of displacements for temperatures, and the other way round."""
    bodies = heat.blocks(COMM, 2)
    refused = llm.Frictionless(), llm.Coulomb(0.3), llm.Tied(gap=0.1), llm.Tied(close_gap=True)
    for law in refused:
        with pytest.raises(llm.ContactInputError, match="is for displacements"):
            heat.Conducting(bodies, law, heat.Linear(2))
    with pytest.raises(llm.ContactInputError, match="a finite number of at least 0"):
        llm.Conductance(-1.0)
    for wrong in (lambda x: x[:3], lambda x: H + 0.0 * x[0]):  # of another number of positions
        with pytest.raises(llm.ContactInputError, match=r"of shape \("):
            heat.Conducting(bodies, llm.Conductance(wrong), heat.Linear(2)).problem.solve()
