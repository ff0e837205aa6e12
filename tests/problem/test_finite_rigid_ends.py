"""Bodies tied to rigid obstacles at finite deformation, which are moved, pressed and turned.

As a script it prints what several ranks find.
"""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from conftest import run_mpi_json
from dolfinx import fem
from end_scenes import matrix
from mpi4py import MPI
from sampling import longer, some_of
from tangents import tangent_errors
from upright_blocks import FOOT, TOP, block

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.finite.obstacles.obstacle_contact import OneSide
from dolfinx_llm.finite.obstacles.tied_obstacle import TiedObstacle
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.against import loaded
from dolfinx_llm.laws.rows import STICK

QUAD, CURVED, TET = ("quad", 1, "saddle"), ("quad", 2, "saddle"), ("tet", 1, "condensed")
SCENES = [
    QUAD, ("quad", 1, "condensed"), CURVED, ("quad", 2, "condensed"),
    ("tet", 1, "saddle"), TET, ("tet", 2, "saddle"),
]  # fmt: skip


def each(levels, *kept):
    """Every scene with every level; in every run those that are kept."""
    return some_of([(*scene, level) for scene in SCENES for level in levels], kept)


TIED = llm.Tied()
LOADS = {
    "force": {"quad": {"force": (10.0, None)}, "tet": {"force": (10.0, None, -5.0)}},
    "moment": {"quad": {"moment": 200.0}, "tet": {"moment": (90.0, -30.0, 60.0)}},
    "both": {
        "quad": {"force": (10.0, -20.0), "moment": 60.0},
        "tet": {
            "force": (None, 5.0, None), "displacement": (0.1, 0.0, 0.1),
            "moment": (None, -90.0, None), "rotation": (0.2, 0.0, -0.1),
        },
    },
}  # fmt: skip


class End:
    """A block whose top supports hold, and whose foot a rigid end may hold; ``hollow``: on a ball
    around (0.5, .., -2) of radius 2."""

    def __init__(self, kind, degree=1, *, comm=MPI.COMM_SELF, hollow=False, high=3, **pose):
        self.domain, self.tags, self.V, self.u, self.F = block(kind, 3, degree, comm, high)
        self.dim = self.domain.geometry.dim
        self.pivot, self.pose = np.full(self.dim, 0.3), pose
        centre = np.array([*(0.5,) * (self.dim - 1), -2.0])
        x = self.domain.geometry.x[:, : self.dim]
        if hollow:
            arm = x[:, :-1] - centre[:-1]
            rise = np.sqrt(4.0 - (arm**2).sum(axis=1)) - 2.0
            x[:, -1] += (1.0 - x[:, -1]) * rise
        up = np.eye(self.dim)[-1]
        self.end = llm.RigidSphere(centre, 2.0) if hollow else llm.RigidPlane(0.0 * up, up)
        self.end.pivot = self.pivot
        for name, value in pose.items():
            setattr(self.end, name, value)
        self.top, self.foot = fem.Function(self.V), fem.Function(self.V)
        self.x = self.V.tabulate_dof_coordinates()[:, : self.dim]
        self.bcs = [fem.dirichletbc(self.top, self.dofs(TOP))]

    def dofs(self, tag):
        facets = self.tags.indices[self.tags.values == tag]
        return fem.locate_dofs_topological(self.V, self.dim - 1, facets)

    def carried(self, x, shift, rotation):
        return (x - self.pivot) @ matrix(rotation).T + self.pivot + shift

    def problem(self, *, tied=True, law=TIED, **options):
        on = [llm.Interface(self.tags, (FOOT, self.end), law=law)]
        bcs = self.bcs if tied else [*self.bcs, fem.dirichletbc(self.foot, self.dofs(FOOT))]
        interfaces = {"interfaces": on} if tied else {}
        return llm.NonlinearContactProblem(self.F, self.u, bcs=bcs, **interfaces, **options)

    def forces(self):
        """(n, dim) that the body exerts on its foot, of the assembled residual, and places."""
        residual = compat.assemble_force([compat.form("F", self.F)], [1.0], self.V)
        foot, u = self.dofs(FOOT), self.u.x.array.reshape(self.x.shape)
        return -residual.reshape(u.shape)[foot], (self.x + u)[foot]


def moment(arm, force):
    if arm.shape[1] == 2:
        return (arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]).sum()
    return np.cross(arm, force).sum(axis=0)


@pytest.mark.parametrize(
    ("kind", "degree", "solver", "hollow"),
    each([False, True], (*QUAD, False), (*CURVED, True), (*TET, True)),
)
def test_as_prescribed_by_conditions(kind, degree, solver, hollow):
    """The same displacements, and in the interface the forces that hold the nodes."""
    dim = 2 if kind == "quad" else 3
    turn, shift = (0.6, (0.1, -0.2)) if dim == 2 else ((0.5, 0.3, -0.4), (0.1, -0.2, -0.1))
    found = []
    for tied in (True, False):
        scene = End(kind, degree, hollow=hollow, rotation=turn, displacement=shift)
        problem = scene.problem(tied=tied, solver=solver)
        scene.foot.x.array[:] = (scene.carried(scene.x, shift, turn) - scene.x).ravel()
        if tied:
            problem.solve(increments=4)
            (result,) = problem.results
        else:
            for part in np.linspace(0.25, 1.0, 4):  # on the way of a rotation, not on its chord
                there = scene.carried(scene.x, part * np.array(shift), part * np.array(turn))
                scene.foot.x.array[:] = (there - scene.x).ravel()
                problem.solve()
        found.append(scene.u.x.array.copy())
    assert np.abs(found[0] - found[1]).max() < 1e-10
    force, x = scene.forces()
    side, size = result.sides[0], np.abs(force).max()
    nearest = np.linalg.norm(side.x[:, None] - x, axis=2).argmin(axis=1)
    assert np.abs(side.x - x[nearest]).max() < 1e-10
    assert np.abs(side.force - force[nearest]).max() < 1e-10 * size
    assert np.abs(result.resultant - force.sum(axis=0)).max() < 1e-10 * size
    assert np.abs(result.moment() - moment(x, force)).max() < 1e-10 * size
    assert set(side.status) == {STICK} and not side.gap.any() and not side.slip.any()
    assert np.allclose(result.displacement, shift) and np.allclose(result.rotation, turn)


@pytest.mark.parametrize(
    ("kind", "degree", "solver", "ends"), each([1, 2], (*QUAD, 2), (*CURVED, 1), (*TET, 2))
)
def test_turned_by_any_angle(kind, degree, solver, ends):
    """A body that is sheared, held by two ends or by one and by supports, then turned."""
    scene = End(kind, degree)
    lid = llm.RigidPlane(np.eye(scene.dim)[-1], -np.eye(scene.dim)[-1], pivot=scene.pivot)
    every = [(FOOT, scene.end), (TOP, lid)][:ends]
    problem = llm.NonlinearContactProblem(
        scene.F,
        scene.u,
        bcs=scene.bcs if ends == 1 else (),
        interfaces=[llm.Interface(scene.tags, pair, law=llm.Tied()) for pair in every],
        solver=solver,
    )
    shift, known = np.array([0.1, -0.05, 0.08])[: scene.dim], None
    for angle in np.deg2rad([0.0, 30.0, 90.0, 180.0]):
        turn = angle if scene.dim == 2 else angle * np.array([1.0, 2.0, -2.0]) / 3.0
        R = matrix(turn)
        scene.top.x.array[:] = (scene.carried(scene.x, 0.0, turn) - scene.x).ravel()
        scene.end.rotation = lid.rotation = turn
        scene.end.displacement = R @ shift
        problem.solve()
        force = problem.results[0].sides[0].force @ R
        known = force if known is None else known
        assert np.abs(force - known).max() < 1e-10 * np.abs(known).max()
    assert len(problem.history) == 1  # all turns before Newton's iteration begins


@pytest.mark.parametrize(
    ("kind", "degree", "solver", "load"),
    each(LOADS, (*QUAD, "both"), (*CURVED, "moment"), (*TET, "force"), (*TET, "both")),
)
def test_force_and_moment(kind, degree, solver, load):
    """The assembled residual balances them about the moved pivot, nodes are where the motion that
    is told carries them, and prescribing that motion gives the same forces."""
    given, forces = LOADS[load][kind], []
    scene = End(kind, degree, **given)
    for _ in range(2):
        problem = scene.problem(solver=solver)
        problem.solve(increments=2)
        (result,) = problem.results
        side, motion = result.sides[0], (result.displacement, result.rotation)
        assert np.abs(side.x - scene.carried(side.X, *motion)).max() < 1e-10
        forces.append(side.force)
        if scene.end.force is not None or scene.end.moment is not None:
            force, x = scene.forces()
            size = np.abs(force).max()
            total = np.concatenate(
                [force.sum(axis=0), np.ravel(moment(x - scene.pivot - motion[0], force))]
            )
            wanted = [*(given.get("force") or (None,) * scene.dim)]
            wanted += [*np.atleast_1d(given.get("moment", (None,) * len(motion[1])))]
            for a, b in zip(total, wanted, strict=True):
                assert b is None or abs(a + b) < 1e-10 * size
        turn = motion[1] if scene.dim == 3 else motion[1][0]
        scene = End(kind, degree, displacement=motion[0], rotation=turn)
    assert np.abs(forces[0] - forces[1]).max() < 1e-9 * np.abs(forces[0]).max()


def test_a_moment_bends_a_rod_round():
    """By 270°, to an arc: the angle is that of a slender beam, M L / E I, and so is the place."""
    scene, thick = End("quad", 2, high=30), 0.05
    scene.domain.geometry.x[:, 0] *= thick
    scene.x[:, 0] *= thick
    scene.end.pivot = scene.pivot = np.array([0.5 * thick, 0.0])
    wanted, stiff = 1.5 * np.pi, 1000.0 / (1.0 - 0.4**2) * thick**3 / 12.0
    scene.end.force, scene.end.moment = (0.0, 0.0), wanted * stiff
    problem = scene.problem()
    problem.solve(increments=10)
    (result,) = problem.results
    angle = result.rotation[0]
    assert abs(angle / wanted - 1.0) < 0.02
    arc = np.array([(1.0 - np.cos(angle)) / angle, 1.0 - np.sin(angle) / angle])
    assert np.abs(result.displacement - arc).max() < 0.02
    assert np.abs(result.resultant).max() < 1e-9
    assert abs(result.moment(scene.pivot + result.displacement)[0] / wanted / stiff + 1.0) < 1e-9


@pytest.mark.parametrize("solver", ["saddle", "condensed"])
def test_supports_on_an_end_under_a_force(solver):
    """Nodes that supports hold hold the end as well, and bear what presses it once."""
    scene = End("quad", force=(None, -20.0), moment=3.0)
    held = fem.locate_dofs_geometrical(scene.V, lambda x: np.isclose(x[1], 0.0) & (x[0] < 0.5))
    scene.bcs.append(fem.dirichletbc(fem.Function(scene.V), held))
    problem = scene.problem(solver=solver)
    problem.solve()
    (result,) = problem.results
    assert np.abs(scene.u.x.array).max() < 1e-12
    assert abs(result.resultant[1] - 20.0) < 1e-9
    assert abs(result.moment(scene.pivot)[0] + 3.0) < 1e-9


@pytest.mark.parametrize("gdim", [2, 3])
@pytest.mark.parametrize("order", [1, 2])
def test_tangent_is_the_derivative(gdim, order):
    """Differences of forces, ties and balance, where the end has been turned by much."""
    rng = np.random.default_rng(5)
    x = rng.uniform(-0.4, 0.4, (gdim, gdim))
    if order == 2:
        middle = 0.5 * (x + np.roll(x, -1, axis=0))
        x = np.concatenate([x, middle if gdim == 3 else middle[:1]])
    n = np.arange(len(x))
    surface = Surface(
        x, n[None, :gdim], n, 0 * n, "patch", elements=n[None] if order == 2 else None
    )
    end = llm.RigidPlane(
        0.5 * np.eye(gdim)[0], np.eye(gdim)[-1], pivot=(0.1, 0.2, 0.3)[:gdim],
        force=(1.0, None, 2.0)[:gdim], displacement=(0.0, 0.1, 0.0)[:gdim],
        moment=0.7 if gdim == 2 else (1.0, None, 2.0), rotation=None if gdim == 2 else (0, 2, 0),
    )  # fmt: skip
    of = end, loaded(end, gdim), n >= 0, x + 0.01 * rng.standard_normal(x.shape), 0 * x + 1.0
    contact = TiedObstacle(OneSide((surface,)), *of)
    q = rng.standard_normal(contact.size)
    held = replace(contact.hold(x.ravel()), scale=5.0)
    errors, sizes = tangent_errors(contact, x.ravel(), q, n * 0 + STICK, held, rng).T
    assert (errors < 1e-6 * sizes).all()


def test_gaps():
    """They are refused with their size, or closed: nodes are on the obstacle then."""
    scene = End("quad", displacement=(0.0, 0.0))
    scene.end.point = np.array([0.0, -0.02])
    with pytest.raises(llm.ContactInputError, match=r"drawn with gaps of up to 0\.02: at finite"):
        scene.problem()
    scene.problem(law=llm.Tied(close_gap=True)).solve()
    force, x = scene.forces()
    assert np.abs(x[:, 1] + 0.02).max() < 1e-12 and force[:, 1].min() > 0.0
    scene.end.point = np.array([0.0, -0.5])
    with pytest.raises(llm.ContactError, match=r"lie up to 0\.5 apart, more than a facet's size"):
        scene.problem(law=llm.Tied(close_gap=True))


def test_drawn_anew_between_steps():
    """The body stayed tied where the end had been, without a word."""
    scene = End("quad", displacement=(0.0, 0.0))
    problem = scene.problem(law=llm.Tied(close_gap=True))
    problem.solve()
    scene.end.point = np.array([0.0, -0.02])
    problem.solve()
    force, x = scene.forces()
    assert np.abs(x[:, 1] + 0.02).max() < 1e-12 and force[:, 1].min() > 0.0
    scene.end.point = np.array([0.0, 0.0])
    problem = scene.problem()
    scene.end.point = np.array([0.0, -0.02])
    with pytest.raises(llm.ContactInputError, match=r"drawn with gaps of up to 0\.02: at finite"):
        problem.solve()


def test_ends_that_nodes_do_not_bear():
    scene = End("quad")
    scene.end = llm.RigidSurface(llm.Frame([[-0.1, 0.0], [0.1, 0.0]], [[0, 1]]), moment=1.0)
    with pytest.raises(llm.ContactError, match=r"the 1 node\(s\) of tag 1 that are tied"):
        scene.problem()


def test_saved_and_read_again(tmp_path):
    """A state goes on where it was, with the end where force and moment had brought it."""
    found = []
    for read in (False, True):
        scene = End("quad", force=(10.0, -20.0), moment=60.0)
        problem = scene.problem()
        if read:
            problem.load(tmp_path / "state.npz")
        else:
            problem.solve()
            problem.save(tmp_path / "state.npz")
        scene.end.moment = 70.0
        problem.solve()
        found.append(problem.results[0])
        assert len(problem.history) < 6
    assert np.allclose(found[0].rotation, found[1].rotation, rtol=1e-10)
    assert np.allclose(found[0].sides[0].force, found[1].sides[0].force, rtol=0, atol=1e-8)


def forces_of(comm, kind, solver):
    """Of an end under a force that is turned, and of one under a moment; and an error's text."""
    found, dim = [], 2 if kind == "quad" else 3
    for load in ("force", "both"):
        scene = End(kind, comm=comm, **LOADS[load][kind])
        if load == "force":
            scene.end.rotation = 0.4 if dim == 2 else (0.4, 0.2, -0.3)
        problem = scene.problem(solver=solver)
        problem.solve(increments=2)
        (result,) = problem.results
        found += [*result.sides[0].force.ravel(), *result.displacement, *result.rotation]
    scene = End(kind, comm=comm)
    scene.end.point = -0.02 * np.eye(dim)[-1]
    try:
        scene.problem()
    except llm.ContactInputError as error:
        return found, str(error)


@pytest.mark.parametrize(
    ("n", "kind", "solver"), [(2, "tet", "condensed"), longer(3, "quad", "saddle"),
                              longer(3, "tet", "saddle"), longer(2, "quad", "condensed")]
)  # fmt: skip
def test_ranks(n, kind, solver):
    several = run_mpi_json(__file__, n, kind, solver)
    found, text = forces_of(MPI.COMM_SELF, kind, solver)
    assert np.allclose(several["found"], found, rtol=1e-9, atol=1e-9 * np.abs(found).max())
    assert several["text"] == text


if __name__ == "__main__":
    found, text = forces_of(MPI.COMM_WORLD, *sys.argv[1:])
    assert len({json.dumps(each) for each in MPI.COMM_WORLD.allgather([found, text])}) == 1
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps({"found": found, "text": text}))
