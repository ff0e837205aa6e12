"""Contact at finite deformation in 3D: exact states, objectivity, order of sides, ranks."""

import finite_patch
import numpy as np
import patch2d
import pytest
from dolfinx import fem
from mpi4py import MPI
from sampling import longer
from scipy.spatial.transform import Rotation

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF


def boxes(low, high, corner=(0.4, 0.2), size=(0.8, 0.6), width=1.6):
    """Foundation and punch with their cells."""
    foundation = ((0.0, 0.0, 0.0), (width, 1.0, 1.0), (*low, 1))
    return foundation, ((*corner, 1.0), (*size, 1.0), (*high, 1))


@pytest.mark.parametrize(
    "scene",
    [
        longer({"kind": "hex", "boxes": boxes((4, 3), (3, 4)), "order": (1, 0)}),
        {"kind": ("hex", "tet"), "boxes": boxes((4, 3), (1, 2)), "pressure": 600.0},
        {"kind": "hex", "boxes": boxes((2, 2), (6, 5), (0.0, 0.0), (1.0, 1.0), 1.0)},
        {"kind": "tet", "boxes": boxes((4, 3), (3, 3), (1.1, 0.2)), "beyond": True},
        # Supports hold more nodes of the punch along y than the frame has free ones.
        {"kind": "tet", "boxes": boxes((3, 3), (4, 3), (0.0, 0.2)), "law": llm.Coulomb(0.3)},
        longer({"kind": "tet", "boxes": boxes((3, 3), (4, 3), (0.0, 0.2)), "law": llm.Tied()}),
    ],
    ids=["hex", "tet on hex", "hex, fine on coarse", "tet beyond the edge", "stick", "tied"],
)
def test_finite_patch(scene):
    """A homogeneous state stands in both bodies, whatever the cells and what they cover."""
    kind, known = scene.pop("kind"), (scene.get("pressure", 300.0), scene.get("young", 1000.0))
    known = finite_patch.stretches(*known, scene.get("poisson", 0.4))
    bodies = patch2d.bodies(COMM, kind, separate=True, boxes=scene["boxes"], rough=0.25)
    problem = finite_patch.problem(bodies, **scene)
    problem.solve(increments=2)
    stretch, pressure = finite_patch.errors(problem, known, scene["boxes"])
    assert stretch < 1e-10 and pressure < 1e-9
    assert max(h["iteration"] for h in problem.history) <= 6
    assert len({h["part"] for h in problem.history}) == 2
    result = problem.results[0]
    assert np.abs(result.frame_friction).max() < 1e-8 * 300.0
    forces = sum(side.force.sum(axis=0) for side in result.sides)
    moments = result.moment(side=0) + result.moment(side=1)
    assert max(np.abs(forces).max(), np.abs(moments).max()) < 1e-10 * 300.0


def about_skew_axis(degrees):
    return Rotation.from_rotvec(np.deg2rad(degrees) * np.array([2.0, 1.0, 2.0]) / 3.0).as_matrix()


def turned(kind, law, degrees=0.0, swapped=False, held=False, cells=(3, 2), **options):
    """A narrow block pressed and pushed along on a wide one, all turned from the start: the
    problem, its sides' forces in the turned base, and a function that turns all to other degrees by
    a load step and returns these forces. The block's side in contact may be held as well; options
    are those of the problem."""
    R = about_skew_axis(degrees)
    ((domain, tags),) = patch2d.bodies(COMM, kind, boxes=boxes((3, 3), cells), rough=0.2)
    V = compat.function_space(domain, shape=(3,))
    u, g = fem.Function(V), fem.Function(V)
    x = V.tabulate_dof_coordinates()
    u.x.array[:] = (x @ R.T - x).ravel()
    facets = tags.indices[tags.values == patch2d.PUNCH_BOTTOM]
    facing = fem.locate_dofs_topological(V, 2, facets[: len(facets) * held])
    moved = x[:, 2:] > 1.5
    moved[facing] = True
    end = x + np.where(moved, [0.05, 0.02, -0.05], 0.0)
    ends = lambda p: np.isclose(p[2], 0.0) | np.isclose(p[2], 2.0)  # noqa: E731
    bc = fem.dirichletbc(g, np.union1d(fem.locate_dofs_geometrical(V, ends), facing))
    order = (patch2d.FOUNDATION_TOP, patch2d.PUNCH_BOTTOM)
    interface = llm.Interface(tags, order[::-1] if swapped else order, law=law)
    F = finite_patch.residual(u, *finite_patch.lame(1000.0, 0.4))
    problem = llm.NonlinearContactProblem(F, u, bcs=[bc], interfaces=[interface], **options)

    def to(degrees):
        R = about_skew_axis(degrees)
        g.x.array[:] = (end @ R.T - x).ravel()
        problem.solve()
        return [side.force @ R for side in problem.results[0].sides]

    return problem, to(degrees), to


@pytest.mark.parametrize(
    "kind, law",
    [
        ("hex", llm.Coulomb(1.0)),  # some of it sticks
        ("tet", llm.Frictionless()),
        ("hex", llm.Tied()),
    ],
    ids=str,
)
def test_objective(kind, law):
    """The scene turned about a skew axis: the same forces in the turned base; sides swapped."""
    still, forces, _ = turned(kind, law)
    residuals = [h["residual"] for h in still.history]
    assert residuals[-1] < 1e-11 < residuals[-2]
    pairs, pressure = still.results[0].sides[1], still.results[0].pressure  # of the punch's nodes
    own = pairs.normal_force[pairs.area > 0.0] / pairs.area[pairs.area > 0.0]
    assert own.min() - 1e-9 < pressure[pressure != 0.0].min() <= pressure.max() < own.max() + 1e-9
    other, found, _ = turned(kind, law, 90.0, swapped=True)
    for a, b in zip(forces[::-1], found, strict=True):
        assert np.abs(a - b).max() < 1e-10 * np.abs(a).max()
    there = other.results[0].sides[0]
    assert (there.status == pairs.status).all()
    assert np.abs(there.slip[there.status == 1]).max(initial=0.0) < 1e-14
    assert np.abs(other.results[0].pressure - pressure).max() < 1e-10 * pressure.max()


@pytest.mark.long
@pytest.mark.parametrize(
    "law", [llm.Tied(), llm.Frictionless(), llm.Coulomb(3.0), llm.Coulomb(0.1)], ids=str
)
def test_turned_in_steps(law):
    """What is turned by up to 180 degrees after it was pressed: the same forces in the turned base
    and the same pressure; what sticks does not slip."""
    problem, forces, to = turned("hex", law)
    pressure = problem.results[0].pressure
    for degrees in np.arange(15.0, 181.0, 15.0):
        for a, b in zip(forces, to(degrees), strict=True):
            assert np.abs(a - b).max() < 1e-10 * np.abs(a).max()
        result = problem.results[0]
        assert np.abs(result.pressure - pressure).max() < 1e-10 * pressure.max()
        side = result.sides[1]
        assert np.abs(side.slip[side.status == 1]).max(initial=0.0) < 1e-12


@pytest.mark.parametrize("law", [llm.Frictionless(), llm.Tied()], ids=str)
def test_held_side(law):
    """Rows at held nodes depend on each other where the frame has fewer nodes; forces stay of the
    size of the load."""
    problem, forces, _ = turned("tet", law, held=True, cells=(4, 3))
    assert len(problem.history) <= 8
    pressed = problem.results[0].sides[1].normal_force
    assert isinstance(law, llm.Tied) or pressed.min() > -1e-9 * pressed.max()
    assert np.abs(forces[1]).max() < np.abs(forces[1].sum(axis=0)).max()
    assert np.abs(sum(f.sum(axis=0) for f in forces)).max() < 1e-9 * pressed.max()
