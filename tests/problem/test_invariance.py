"""What must not change the answer: number of ranks, order of sides, units, position in space."""

import itertools

import numpy as np
import paper_data as paper
import patch3d
import pytest
import scenes
import solve_scenes
from conftest import run_mpi_json
from dolfinx import fem
from mpi4py import MPI
from sampling import longer, some_of

import dolfinx_llm as llm
from dolfinx_llm import compat, post

# Number of ranks


@pytest.fixture(scope="module")
def one_rank():
    """Scenes solved on one rank, each when first asked for."""
    solved = {}

    def get(name):
        if name not in solved:
            solved[name] = solve_scenes.collect(solve_scenes.SCENES[name](MPI.COMM_SELF))
        return solved[name]

    return get


def same(found, known, bound=1e-12):
    """Positions alike; displacements, frame and forces to the bound of their largest value."""
    assert found.keys() == known.keys()
    size = {}
    for key in known:
        a = np.array(known[key])
        kind = {"f": "force", "x": "x", "c": "cells"}.get(key[0], "u")
        kind = "x" if key == "frame" else kind
        size[kind] = max(size.get(kind, 0.0), np.abs(a).max())
    for key in known:
        a, b = np.array(found[key]), np.array(known[key])
        assert a.shape == b.shape, key
        kind = {"f": "force", "x": "x", "c": "cells"}.get(key[0], "u")
        kind = "x" if key == "frame" else kind
        assert np.abs(a - b).max() <= bound * size[kind], key
    assert np.abs(known["u"]).max() > 0.0 and np.abs(known["force0"]).max() > 0.0


@pytest.mark.parametrize(
    ("n", "names"),
    [(2, ["predicted", "two meshes"]), (3, ["symmetric"]), longer(2, ["symmetric"]),
     longer(3, ["paper"]), longer(4, ["clamped"])],
)  # fmt: skip
def test_number_of_ranks(n, names, one_rank):
    found = run_mpi_json("solve_scenes.py", n, *names)
    assert list(found) == names
    for name in names:
        same(found[name], one_rank(name))


@pytest.mark.long
def test_optimised_frame_on_two_ranks(one_rank):
    """The search for positions ends at the same frame."""
    same(run_mpi_json("solve_scenes.py", 2, "optimised")["optimised"], one_rank("optimised"))


@pytest.mark.parametrize("n", [1, 3])
def test_operators(n):
    for name, found in run_mpi_json("check_operators.py", n).items():
        assert found["redundant"] == 0 if name == "clamped" else found["redundant"] > 0
        del found["redundant"]
        assert {k: e for k, e in found.items() if not abs(e) < 1e-13} == {}, name


def test_two_meshes_are_as_one(one_rank):
    one, two = one_rank("clamped"), one_rank("two meshes")
    assert np.abs(np.array(one["frame"]) - two["frame"]).max() < 1e-14
    assert np.abs(np.array(one["v"]) - two["v"]).max() < 1e-12 * np.abs(one["u"]).max()
    for k in (0, 1):
        a, b = np.array(one[f"force{k}"]), np.array(two[f"force{k}"])
        assert np.abs(a - b).max() < 1e-12 * np.abs(a).max()


# Order of the sides


def swapped(found):
    """Results as of sides named in the other order."""
    other = {"0": "1", "1": "0"}
    return {key[:-1] + other.get(key[-1], key[-1]): value for key, value in found.items()}


def frame_sorted(found):
    """The frame's nodes sorted by position; its cells left out."""
    found = {key: np.array(value) for key, value in found.items() if key != "cells"}
    order = np.lexsort(np.round(found["frame"], 9).T)
    return {**found, "frame": found["frame"][order], "v": found["v"][order]}


@pytest.mark.parametrize("name", ["predicted", "paper", "clamped", "symmetric", "two meshes"])
def test_order_of_sides(name, one_rank):
    comm = MPI.COMM_SELF
    if name == "two meshes":
        contact = solve_scenes.loaded_meshes(comm, order=(1, 0))
    elif name in ("predicted", "paper"):
        sides = (paper.PUNCH_BOTTOM, paper.FOUNDATION_TOP)
        contact = solve_scenes.paper_scene(comm, name, sides)
    else:
        conditions = solve_scenes.CLAMPED if name == "clamped" else scenes.SYMMETRY
        contact = solve_scenes.loaded_blocks(comm, conditions, sides=(3, 2))
    found, known = swapped(solve_scenes.collect(contact)), dict(one_rank(name))
    if name == "two meshes":  # sorted within each mesh, the meshes in the order of the forms
        n = contact.spaces[0].dofmap.index_map.size_local
        for key in ("x", "u"):
            found[key] = found[key][n:] + found[key][:n]
    same(frame_sorted(found), frame_sorted(known))


def test_order_of_sides_with_equal_meshes():
    """Two sides as coarse as each other: the choice of the frame does not hang on the order."""
    found = []
    for sides in ((2, 3), (3, 2)):
        sections = [scenes.grid(4, 4, jitter=0.3, seed=s) for s in (5, 6)]
        domain, tags = scenes.stacked(MPI.COMM_SELF, sections, (0.0, 1.0, 2.0))
        V = compat.function_space(domain, shape=(3,))
        a, L = solve_scenes.loaded_forms(V)
        bcs = scenes.hold(V, solve_scenes.CLAMPED)
        contact = llm.ContactProblem(a, L, bcs=bcs, interfaces=[llm.Interface(tags, sides)])
        found.append(solve_scenes.collect(contact))
    same(frame_sorted(swapped(found[1])), frame_sorted(found[0]))


# Units and position: the patch test's figures, with their bounds


def solve_moved(length=1.0, R=None, shift=0.0, scale=1.0, kind="predicted", pressure=260.0):
    """The paper's scene scaled, turned and shifted; largest relative error of each figure.

    The bottom's nodes get the exact displacement, which is linear.
    """
    R = np.eye(3) if R is None else R
    comm = MPI.COMM_SELF
    domain, tags = paper.scene(comm, 1, transform=lambda x: length * x @ R.T + shift)
    V = compat.function_space(domain, shape=(3,))
    strain = np.diag([0.3, 0.3, -1.0]) * pressure / (paper.E * scale)
    gradient = R @ strain @ R.T
    origin = np.zeros(3) + shift

    def exact(p):
        return gradient @ (p - origin[:, None])

    value = fem.Function(V)
    value.interpolate(exact)
    dofs = fem.locate_dofs_topological(V, 2, tags.find(paper.BOTTOM))
    frame = patch3d.contact_frame(kind)
    if frame is not None:
        frame = llm.Frame(length * frame.x @ R.T + shift, frame.cells)
    covered = (tags, paper.PUNCH_BOTTOM)
    a, L = scenes.forms(V, scale)
    contact = llm.ContactProblem(
        a,
        L,
        bcs=[fem.dirichletbc(value, dofs)],
        interfaces=[llm.Interface(tags, (paper.FOUNDATION_TOP, paper.PUNCH_BOTTOM), frame=frame)],
        nodal_loads=[
            llm.free_surface_load(V, tags, paper.PUNCH_TOP, pressure),
            llm.free_surface_load(V, tags, paper.FOUNDATION_TOP, pressure, covered_by=covered),
        ],
    )
    u = contact.solve()
    stress = post.von_mises(scenes.stress(u, scale))
    values = post.at_quadrature_points(stress, domain)
    result = contact.results[0]
    frame = result.frame
    v = exact(frame.x.T).T
    normal = R @ [0.0, 0.0, 1.0]
    largest = max(s.area.max() for s in result.sides) * pressure
    loads = [
        s.force - sign * pressure * np.outer(s.area, normal)
        for s, sign in zip(result.sides, (1.0, -1.0), strict=True)
    ]
    area = 7.0 * np.sin(np.pi / 7.0) * length**2
    return {
        "von Mises": np.abs(values / pressure - 1.0).max(),
        "displacement": scenes.displacement_error(u, exact),
        "frame": np.abs(frame.v - v).max() / np.abs(v).max(),
        "forces": max(np.abs(f).max() for f in loads) / largest,
        "friction": max(np.abs(s.tangential_force).max() for s in result.sides) / largest,
        "area": max(abs(s.area.sum() / area - 1.0) for s in result.sides),
    }


def turn(seed):
    """A random rotation."""
    Q = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    return Q * np.linalg.det(Q)


DIAMETER = np.sqrt(2.8**2 + 2.8**2 + 2.0**2)
MOVES = {
    "as it is": ({}, 1e-12),
    "length x 1e-3": ({"length": 1e-3}, 1e-10),
    "length x 1e3": ({"length": 1e3}, 1e-10),
    "E x 1e6": ({"scale": 1e6}, 1e-10),
    "E x 1e6, pressure x 1e6": ({"scale": 1e6, "pressure": 260e6}, 1e-10),
    "turned": ({"R": turn(17)}, 1e-10),
    "turned otherwise": ({"R": turn(18)}, 1e-10),
    "upside down": ({"R": np.diag([1.0, -1.0, -1.0])}, 1e-10),
    "on its side": ({"R": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])}, 1e-10),
    "shifted": ({"shift": 100.0 * DIAMETER * np.array([0.6, -0.64, 0.48])}, 1e-10),
    "all": (
        {
            "length": 1e-3,
            "R": turn(19),
            "shift": 0.1 * DIAMETER * np.array([0.6, 0.64, -0.48]),
            "scale": 1e6,
        },
        1e-10,
    ),
    "all, large": (
        {"length": 1e3, "R": turn(20), "shift": 1e5 * DIAMETER * np.array([-0.6, 0.64, 0.48])},
        1e-10,
    ),
}


FRAMES = ["predicted", "automatic"]


@pytest.mark.parametrize(
    ("name", "kind"),
    some_of(itertools.product(MOVES, FRAMES), list(zip(MOVES, itertools.cycle(FRAMES)))[::2]),
)
def test_units_and_position(name, kind):
    move, bound = MOVES[name]
    found = solve_moved(kind=kind, **move)
    assert {key: e for key, e in found.items() if not e <= bound} == {}


# Prescribed dofs on the contact surface


CHOLESKY = {"solver": "condensed", "petsc_options": {"ksp_type": "preonly", "pc_type": "cholesky"}}


@pytest.mark.parametrize(
    ("n0", "n1", "design", "options"),
    [(4, 3, "auto", None), (3, 4, "weights", CHOLESKY), (5, 5, "weights", None),
     (4, 3, "auto", CHOLESKY), (5, 5, "auto", CHOLESKY), longer(6, 9, "weights", None)],
)  # fmt: skip
def test_symmetry_planes_through_the_contact(n0, n1, design, options):
    """A quarter model: both bodies have prescribed dofs on the contact, more than the frame."""
    V, tags = scenes.two_blocks(MPI.COMM_SELF, n0, n1)
    contact = scenes.block_problem(V, tags, design=design, options=options)
    scenes.check_uniaxial(contact, contact.solve())


@pytest.mark.parametrize("n1", [3, 5])
def test_prescribed_edge_of_the_contact(n1):
    """All of the bodies' sides have prescribed displacements, the contact's edge with them."""

    def shear(p):
        return np.array([0.02 * p[2] + 0.01 * p[0], 0.01 * p[1], -0.03 * p[2]])

    V, tags = scenes.two_blocks(MPI.COMM_SELF, 4, n1)
    planes = [scenes.on(0, 0.0), scenes.on(0, 1.0), scenes.on(1, 0.0), scenes.on(1, 1.0)]
    planes += [scenes.on(2, 0.0), scenes.on(2, 2.0)]
    conditions = [(k, where) for k in range(3) for where in planes]
    bcs = scenes.hold(V, conditions, shear)
    contact = scenes.block_problem(V, tags, bcs=bcs, loads=[])
    u = contact.solve()
    assert scenes.displacement_error(u, shear) <= 1e-12
    result = contact.results[0]
    assert np.abs(result.frame.v - shear(result.frame.x.T).T).max() <= 1e-12
    mu, lam = 1000.0, 1500.0  # of E = 2600, nu = 0.3
    traction = [mu * 0.02, 0.0, lam * (0.01 + 0.01 - 0.03) - 2 * mu * 0.03]
    for side in result.sides:
        inner = ((side.x[:, :2] > 1e-9) & (side.x[:, :2] < 1 - 1e-9)).all(axis=1)
        sign = np.sign(side.normal[0, 2])  # a traction on the body, out of it
        exact = -np.outer(side.area, traction) * sign
        assert inner.any()
        assert np.abs(side.force - exact)[inner].max() <= 1e-11 * np.abs(exact).max()
    assert np.abs(sum(side.force.sum(axis=0) for side in result.sides)).max() < 1e-10
