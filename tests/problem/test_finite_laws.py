"""Laws of one's own at finite deformation, as of the demo: exact states, history, turned scenes."""

import finite_patch
import numpy as np
import pytest
from dolfinx import fem
from own_law import Glue, Soft
from sampling import longer
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from test_finite_obstacles import FOOT, TOP, block, rolled

import dolfinx_llm as llm

SOFT, GLUE = Soft(30.0, 0.05), Glue(4000.0, first=0.05, last=0.6)
SMOOTH = Glue(4000.0, ratio=0.0, first=0.05, last=0.6)  # nothing resists along the surface
MU, LAM = finite_patch.lame(1000.0, 0.4)  # of ``block``


def stretched(b, dim):
    """Cauchy stress of a column whose height is b times the drawn one, free at its sides."""

    def pull(a, other):
        return MU * (a - 1.0 / a) + LAM * np.log(b * other ** (dim - 1)) / a

    a = brentq(lambda a: pull(a, a), 0.3, 3.0, xtol=1e-15)
    return pull(b, a) / a ** (dim - 1)


def height(traction, U, dim):
    """b of two columns, drawn 1 high, whose ends are moved apart by U: they are pulled at by
    traction(opening) [force / area now]."""
    return brentq(lambda b: traction(U - 2.0 * (b - 1.0)) - stretched(b, dim), 0.4, 2.5, xtol=1e-15)


def soft(law, opening, worst):
    return -law.p0 * np.expm1(max(-opening, 0.0) / law.h)


def glue(law, opening, worst):
    if opening < 0.0:
        return law.k * opening
    felt = np.clip(max(opening, worst), law.first, law.last)
    return law.k * opening * law.first * (law.last - felt) / felt / (law.last - law.first)


def poses(law, dim):
    """Steps of a glued body that is moved along and off what it faces, and turned with it: its jump
    and what resists [force / area], both as drawn; the rotation, as a vector and a matrix."""
    jump, weight = np.zeros(dim), np.array([law.ratio] * (dim - 1) + [1.0])
    axis = np.eye(3)[2] if dim == 2 else np.array([0.48, 0.6, 0.64])
    for turn, slide in ((0.0, 0.02), (0.0, 0.03), (0.5, 0.0), (1.0, 0.0), (1.0, 0.02)):
        jump = jump + slide * np.array([1.0, -0.5, 0.4])[[0, -1] if dim == 2 else [0, 1, 2]]
        felt = max(np.sqrt(weight @ jump**2), law.first)
        share = law.first * (law.last - felt) / felt / (law.last - law.first)
        R = Rotation.from_rotvec(turn * axis).as_matrix()[:dim, :dim]
        yield jump, law.k * share * weight * jump, turn * axis, R
    assert felt > law.first


class Columns:
    """Two blocks upon each other; ``move`` takes both ends' or all nodes' displacements."""

    def __init__(self, kind, law, cells=(2, 3), order=(0, 1), rigid=False):
        bodies = [block(kind, n) for n in cells]
        self.spaces = [V for _, _, V, _, _ in bodies]
        dim = self.spaces[0].mesh.geometry.dim
        bodies[1][0].geometry.x[:, dim - 1] += 1.0
        bcs, self.u = [], [u for _, _, _, u, _ in bodies]
        self.g = [fem.Function(V) for V in self.spaces]
        for z, V, g in zip((0.0, 2.0), self.spaces, self.g, strict=True):
            if rigid:
                every = np.arange(V.dofmap.index_map.size_local, dtype=np.int32)
                bcs.append(fem.dirichletbc(g, every))
                continue
            bcs += rolled(V, range(dim - 1))
            W = V.sub(dim - 1).collapse()[0]
            end = fem.locate_dofs_geometrical(
                (V.sub(dim - 1), W), lambda x, z=z: np.isclose(x[dim - 1], z)
            )
            self.end = fem.Function(W)
            bcs.append(fem.dirichletbc(self.end, end, V.sub(dim - 1)))
        sides = (bodies[0][1], TOP), (bodies[1][1], FOOT)
        interface = llm.Interface(None, tuple(sides[i] for i in order), law=law)
        self.problem = llm.NonlinearContactProblem(
            [F for *_, F in bodies], self.u, bcs=bcs, interfaces=[interface]
        )

    def solve(self):
        self.problem.solve()
        return self.problem.results[0]


@pytest.mark.parametrize(
    ("law", "known", "pulls", "kind", "order"),
    [  # the last of the pulls opens or breaks
        (SOFT, soft, (-0.05, -0.4, 0.02), "tet", (0, 1)),
        (GLUE, glue, (0.3, 0.55, 0.2, -0.1, 0.8), "quad", (1, 0)),
        longer(SOFT, soft, (-0.05, -0.4, 0.02), "quad", (1, 0)),
        longer(GLUE, glue, (0.3, 0.55, 0.2, -0.1, 0.8), "tet", (0, 1)),
    ],
)
def test_closed_forms(law, known, pulls, kind, order):
    """Pressed by half of its height, pulled until it breaks, and unloaded on the way: uniform
    tractions on the area now, as the law says of the largest opening so far."""
    columns, worst = Columns(kind, law, order=order), 0.0
    dim = columns.spaces[0].mesh.geometry.dim
    for U in pulls:
        columns.end.x.array[:] = U
        result = columns.solve()
        b = height(lambda d, at=worst: known(law, d, at), U, dim)
        worst, stress = max(worst, U - 2.0 * (b - 1.0)), stretched(b, dim)
        assert np.abs(result.pressure + stress).max() < 1e-9 * max(abs(stress), 1.0)
        assert np.abs(result.traction).max() < 1e-9
        if abs(stress) > 1e-6:
            gap = result.sides[order.index(1)].gap  # of the finer side
            assert np.abs(gap - (U - 2.0 * (b - 1.0))).max() < 1e-10
            moved = columns.u[0].x.array.reshape(-1, dim)[:, -1]
            assert abs(moved[np.abs(moved).argmax()] - (b - 1.0)) < 1e-11
    assert abs(stress) < 1e-6


def test_what_a_law_keeps_is_saved(tmp_path):
    """A glue that has softened is as soft after ``load``; another mesh does not take that over."""
    first, second = (Columns("quad", GLUE) for _ in range(2))
    for U in (0.55, 0.2):
        first.end.x.array[:] = U
        first.solve()
    first.problem.save(tmp_path / "state.npz")
    second.problem.load(tmp_path / "state.npz")
    for columns in (first, second):
        columns.end.x.array[:] = 0.4
        columns.solve()
    known, found = (columns.problem.results[0].pressure for columns in (first, second))
    assert known.max() < 0.0
    np.testing.assert_allclose(found, known, rtol=1e-10)
    with pytest.raises(llm.ContactInputError, match="laws of your own"):
        llm.transfer(first.problem, Columns("quad", GLUE).problem)


@pytest.mark.parametrize("kind", ["quad", longer("tet")])
def test_slips_as_told_in_any_pose(kind):
    """A glued body that is moved along and off the other one in steps, and turned with it: the
    traction belongs to the whole jump, along the surface as well, and turns with the bodies."""
    law = Glue(400.0, ratio=0.5, first=0.05, last=0.6)
    columns = Columns(kind, law, cells=(2, 2), rigid=True)
    dim = columns.spaces[0].mesh.geometry.dim
    for jump, force, _, R in poses(law, dim):  # the force is on the upper body, minus
        for k, (V, g) in enumerate(zip(columns.spaces, columns.g, strict=True)):
            X = V.tabulate_dof_coordinates()[:, :dim]
            g.x.array[:] = ((X + k * jump) @ R.T - X).ravel()
        result = columns.solve()
        area = result.frame_area.sum()
        assert np.abs(result.resultant + area * (R @ force)).max() < 1e-9
        assert np.abs(result.pressure + force[-1]).max() < 1e-9


@pytest.mark.parametrize(
    ("law", "known", "pulls", "kind"),
    [
        (SOFT, soft, (-0.05, -0.4, 0.02), "tet"),
        (SMOOTH, glue, (0.3, 0.55, 0.2, -0.1, 0.8), "quad"),
        longer(SOFT, soft, (-0.05, -0.4, 0.02), "quad"),
        longer(SMOOTH, glue, (0.3, 0.55, 0.2, -0.1, 0.8), "tet"),
    ],
)
def test_closed_forms_on_an_obstacle(law, known, pulls, kind):
    """One block on a rigid plane that is moved away from it, or into it."""
    _, tags, V, u, F = block(kind, 2)
    dim, worst = V.mesh.geometry.dim, 0.0
    plane = llm.RigidPlane(np.zeros(dim), np.eye(dim)[-1], displacement=np.zeros(dim))
    W = V.sub(dim - 1).collapse()[0]
    top = fem.locate_dofs_geometrical((V.sub(dim - 1), W), lambda x: np.isclose(x[dim - 1], 1.0))
    bcs = [*rolled(V, range(dim - 1)), fem.dirichletbc(fem.Function(W), top, V.sub(dim - 1))]
    interface = llm.Interface(tags, (FOOT, plane), law=law)
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])
    for U in pulls:
        plane.displacement = -U * np.eye(dim)[-1]
        problem.solve()
        left = lambda b, U=U, at=worst: known(law, U - b + 1.0, at) - stretched(b, dim)  # noqa: E731
        b = brentq(left, 0.4, 2.5, xtol=1e-15)
        worst, stress = max(worst, U - b + 1.0), stretched(b, dim)
        result = problem.results[0]
        assert np.abs(result.pressure + stress).max() < 1e-8 * max(abs(stress), 1.0)
        if abs(stress) > 1e-6:
            assert np.abs(result.sides[0].gap - (U - b + 1.0)).max() < 1e-9
    assert abs(stress) < 1e-6


@pytest.mark.parametrize("kind", ["quad", longer("tet")])
def test_slips_as_told_on_an_obstacle(kind):
    """A glued rigid body is moved along and off a plane, and turned with it."""
    law = Glue(400.0, ratio=0.5, first=0.05, last=0.6)
    _, tags, V, u, F = block(kind, 2)
    dim, g = V.mesh.geometry.dim, fem.Function(V)
    every = np.arange(V.dofmap.index_map.size_local, dtype=np.int32)
    still = 0.0 if dim == 2 else np.zeros(3)
    plane = llm.RigidPlane(np.zeros(dim), np.eye(dim)[-1], rotation=still)
    interface = llm.Interface(tags, (FOOT, plane), law=law)
    problem = llm.NonlinearContactProblem(
        F, u, bcs=[fem.dirichletbc(g, every)], interfaces=[interface]
    )
    X = V.tabulate_dof_coordinates()[:, :dim]
    for jump, force, turn, R in poses(law, dim):
        plane.rotation = turn[2] if dim == 2 else turn
        g.x.array[:] = ((X + jump) @ R.T - X).ravel()
        problem.solve()
        (side,) = problem.results[0].sides
        assert np.abs(side.force.sum(axis=0) - side.area.sum() * R @ force).max() < 1e-9


def test_refused():
    class Bound(llm.Law):
        gives = True

    with pytest.raises(llm.ContactInputError, match="ties along the surface"):
        Columns("quad", Bound())
    columns = Columns("quad", Glue(400.0, first=0.05, last=9.0), cells=(2, 3), rigid=True)
    columns.g[1].x.array[1::2] = 1.5
    columns.solve()
    columns.g[1].x.array[1::2] = 3.0
    columns.solve()
    columns.g[1].x.array[1::2] = 3.1
    with pytest.raises(llm.ContactError, match="farther than 4 facets"):
        columns.solve()
