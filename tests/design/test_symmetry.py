"""A scene mirrored, turned, shifted or renumbered gives the same answer; a symmetric one a
symmetric one. Nodes on edges and nodes of the frame, of which several cells may claim them, and
choices among equally good ones are what this tests."""

import numpy as np
import pairs
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from sampling import some_of

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF
BELOW, ABOVE = 1, 2
TRIANGLES = [[0, 1, 3], [0, 3, 2]]


def bricks(n, low, high, kind, jitter=0.0, seed=17):
    """Points and cells of a block; inner nodes moved within the plane, alike in all layers."""
    gdim, rng = len(n), np.random.default_rng(seed)
    axes = [np.linspace(0.0, 1.0, k + 1) for k in n]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    shake = rng.uniform(-jitter, jitter, (*x.shape[:-2], 1, gdim - 1)) / np.array(n[:-1])
    for k in range(gdim - 1):
        np.moveaxis(shake, k, 0)[[0, -1]] = 0.0
    x[..., :-1] += shake
    node = np.arange(x[..., 0].size).reshape([k + 1 for k in n])
    corner = [np.array(c[::-1]) for c in np.ndindex(*(2,) * gdim)]  # dolfinx: x runs first
    cells = np.stack(
        [node[tuple(slice(i, i + k) for i, k in zip(c, n, strict=True))].ravel() for c in corner],
        axis=1,
    )
    if kind == "simplex":
        split = np.array(TRIANGLES if gdim == 2 else pairs.TETS)
        cells = cells[:, split].reshape(-1, gdim + 1)
    return np.asarray(low) + x.reshape(-1, gdim) * (np.asarray(high) - low), cells


class Move:
    """x -> R x + shift, and other numbers for nodes and cells."""

    def __init__(self, gdim, R=None, shift=0.0, renumber=None):
        self.R = np.eye(gdim) if R is None else R
        self.shift, self.renumber = shift, renumber

    def __call__(self, x):
        return x @ self.R.T + self.shift

    def back(self, x):
        return (x - self.shift) @ self.R

    def mesh(self, x, cells):
        gdim, x = x.shape[1], self(x)
        if np.linalg.det(self.R) < 0.0 and len(cells[0]) == 2**gdim:  # keep cells right-handed
            cells = cells.reshape(len(cells), -1, 2)[..., ::-1].reshape(len(cells), -1)
        if self.renumber is not None:
            rng = np.random.default_rng(self.renumber)
            order = rng.permutation(len(x))
            x, cells = x[order], np.argsort(order)[cells][rng.permutation(len(cells))]
        names = (
            {3: "triangle", 4: "quadrilateral"}
            if gdim == 2
            else {4: "tetrahedron", 8: "hexahedron"}
        )
        return compat.create_mesh(COMM, cells, x, names[cells.shape[1]])


def tagged(domain, move, levels):
    """Tags of the facets at the lowest and highest level of the block at rest."""
    gdim = domain.geometry.dim
    found = [
        mesh.locate_entities_boundary(
            domain, gdim - 1, lambda p, z=z: np.isclose(move.back(p.T[:, :gdim])[:, -1], z)
        )
        for z in levels
    ]
    facets = np.concatenate(found)
    values = np.repeat([BELOW, ABOVE], [len(f) for f in found]).astype(np.int32)
    order = np.argsort(facets)
    return mesh.meshtags(domain, gdim - 1, facets[order], values[order])


def solved(blocks, law, steps, move, **options):
    """Two blocks, the lower one held at its base, the top of the upper one moved.

    Args:
        blocks: [(points, cells), ...], the lower one from 0 to 1, the upper one on it, to 2.
        steps: motions of the top, of positions (n, gdim), all as in the scene at rest.

    Returns:
        Dict of arrays, turned back and sorted by place.
    """
    gdim = blocks[0][0].shape[1]
    domains = [move.mesh(*block) for block in blocks]
    tags = [tagged(d, move, z) for d, z in zip(domains, ((0.0, 1.0), (1.0, 2.0)), strict=True)]
    spaces = [compat.function_space(d, shape=(gdim,)) for d in domains]
    bcs, motion = [], fem.Function(spaces[1])
    for V, z, value in ((spaces[0], 0.0, fem.Function(spaces[0])), (spaces[1], 2.0, motion)):
        at = lambda p, z=z: np.isclose(move.back(p.T[:, :gdim])[:, -1], z)  # noqa: E731
        bcs.append(fem.dirichletbc(value, fem.locate_dofs_geometrical(V, at)))
    forms = [(ufl.TrialFunction(V), ufl.TestFunction(V)) for V in spaces]
    mu, lam = 1000.0, 1500.0
    a = []
    for u, w in forms:
        eps = ufl.sym(ufl.grad(u))
        stress = 2 * mu * eps + lam * ufl.tr(eps) * ufl.Identity(gdim)
        a.append(ufl.inner(stress, ufl.grad(w)) * ufl.dx)
    L = [
        ufl.inner(fem.Constant(V.mesh, np.zeros(gdim)), w) * ufl.dx
        for V, (_, w) in zip(spaces, forms, strict=True)
    ]
    interface = llm.Interface(None, ((tags[0], ABOVE), (tags[1], BELOW)), law=law, **options)
    problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface])
    for step in steps:
        motion.interpolate(lambda p, step=step: (step(move.back(p.T[:, :gdim])) @ move.R.T).T)
        u = problem.solve()
    result, found = problem.results[0], {}
    for k, function in enumerate(u):
        x = function.function_space.tabulate_dof_coordinates()[:, :gdim]
        found[f"u{k}"] = placed(move, x, function.x.array.reshape(-1, gdim) @ move.R)
    for k, side in enumerate(result.sides):
        found[f"force{k}"] = placed(move, side.x, side.force @ move.R)
    found["pressure"] = placed(move, result.frame.x, np.reshape(result.pressure, (-1, 1)))
    problem.destroy()
    return found


def placed(move, x, values):
    """Positions at rest and values there, sorted by place."""
    x = move.back(x)
    order = np.lexsort(np.round(x, 7).T)
    return x[order], values[order]


def same(found, known, bound):
    """All quantities agree to the bound, of their largest value."""
    size = {}
    for key, (_, value) in known.items():
        size[key[0]] = max(size.get(key[0], 0.0), np.abs(value).max())
    off = {}
    for key, (x, value) in known.items():
        assert found[key][0].shape == x.shape, key
        assert np.abs(found[key][0] - x).max() < 1e-9, key
        off[key] = np.abs(found[key][1] - value).max() / size[key[0]]
    assert {k: e for k, e in off.items() if not e <= bound} == {}
    assert min(size.values()) > 0.0


def press(x):
    u = np.zeros_like(x)
    u[:, -1] = -0.02
    return u


def rock(x):
    """Pressed and tilted: part of the interface opens."""
    u = press(x)
    u[:, -1] += 0.05 * x[:, 0]
    return u


def drag(x):
    u = press(x)
    u[:, 0] = 0.012
    return u


LAWS = {
    "tied": (llm.Tied(), [rock]),
    "opening": (llm.Frictionless(), [rock]),
    "friction": (llm.Coulomb(0.3), [press, drag]),
}


def turn(gdim, seed):
    Q = np.linalg.qr(np.random.default_rng(seed).standard_normal((gdim, gdim)))[0]
    Q[:, 0] *= np.linalg.det(Q)
    return Q


def moves(gdim):
    """Motions and bounds; in 3D, where they take long, all of a turned scene in one."""
    mirror = np.eye(gdim)
    mirror[0, 0] = -1.0
    if gdim == 3:
        return {
            "mirrored": (Move(gdim, mirror), 1e-12),
            "turned, mirrored and renumbered": (Move(3, turn(3, 7) @ mirror, -0.2, 23), 1e-10),
        }
    return {
        "mirrored": (Move(gdim, mirror), 1e-12),
        "upside down": (Move(gdim, np.diag([1.0] * (gdim - 1) + [-1.0])), 1e-12),
        "renumbered": (Move(gdim, renumber=19), 1e-12),
        "turned": (Move(gdim, turn(gdim, 5), 0.3, 23), 1e-10),
        "turned by a quarter": (Move(gdim, np.roll(np.eye(gdim), 1, axis=0)), 1e-10),
        "turned and mirrored": (Move(gdim, turn(gdim, 7) @ mirror, -0.2), 1e-10),
    }


def scene(gdim, cover, kind, n=(6, 4), jitter=0.0):
    """The lower block from -1 to 1; the upper one covers it whole, in part, or lies aside."""
    reach = {"whole": (-1.0, 1.0), "part": (-0.6, 0.6), "aside": (-0.45, 1.3)}[cover]
    wide = [(k,) * (gdim - 1) + (2,) for k in n]
    flat = gdim - 1
    return [
        bricks(wide[0], (-1.0,) * flat + (0.0,), (1.0,) * flat + (1.0,), kind, jitter),
        bricks(wide[1], (reach[0],) * flat + (1.0,), (reach[1],) * flat + (2.0,), kind, jitter, 31),
    ]


CASES = [
    (2, "brick", (9, 6), "whole"), (2, "simplex", (7, 7), "part"), (2, "brick", (5, 8), "aside"),
    (3, "brick", (4, 3), "whole"), (3, "brick", (3, 4), "part"), (3, "simplex", (4, 3), "aside"),
    (3, "simplex", (3, 3), "whole"), (3, "simplex", (6, 2), "part"), (3, "brick", (4, 4), "part"),
]  # fmt: skip


def by_turns(cases):
    """In every run each second case with one of the laws."""
    rows = [(*case, law) for case in cases for law in LAWS]
    return some_of(rows, [rows[len(LAWS) * k + k % len(LAWS)] for k in range(0, len(cases), 2)])


@pytest.mark.parametrize("gdim, kind, n, cover, law", by_turns(CASES))
def test_moved_scenes(gdim, kind, n, cover, law):
    """Displacement, forces and pressure, turned back."""
    blocks = scene(gdim, cover, kind, n)
    known = solved(blocks, *LAWS[law], Move(gdim))
    for name, (move, bound) in moves(gdim).items():
        try:
            same(solved(blocks, *LAWS[law], move), known, bound)
        except AssertionError as error:
            raise AssertionError(f"{name}: {error}") from error


@pytest.mark.parametrize("gdim", [2, 3])
def test_equally_coarse_sides(gdim):
    """Two meshes of as many facets, shaken differently: which makes the frame hangs on no axis."""
    blocks = scene(gdim, "whole", "brick", (4, 4), jitter=0.2)
    known = solved(blocks, *LAWS["tied"], Move(gdim))
    for move, bound in moves(gdim).values():
        same(solved(blocks, *LAWS["tied"], move), known, bound)


def press_alone(x):
    u = press(x)
    u[:, -1] -= 0.01 * x[:, 0] ** 2
    return u


@pytest.mark.parametrize(
    "gdim, n, law",
    by_turns([(2, (9, 6)), (2, (7, 5)), (3, (4, 3)), (3, (3, 4)), (3, (6, 2))]),
)
def test_symmetric_scenes(gdim, n, law):
    """The answer is its own mirror image."""
    for cover in ("whole", "part"):
        blocks = scene(gdim, cover, "brick", n)
        found = solved(blocks, LAWS[law][0], [press_alone], Move(gdim))
        for key, (x, value) in found.items():
            for axis in range(gdim - 1):
                sign = np.ones(gdim)
                sign[axis] = -1.0
                image = value * sign if value.shape[1] == gdim else value
                at, mirrored = placed(Move(gdim, np.diag(sign)), x, image)
                assert np.abs(at - x).max() < 1e-9, key
                size = max(np.abs(v).max() for k, (_, v) in found.items() if k[0] == key[0])
                assert np.abs(mirrored - value).max() <= 1e-12 * size, (cover, key, axis)
