"""Blocks that may part and slide: random scenes in 2D and 3D, and the conditions to be met."""

import numpy as np
import pairs
import scenes
import ufl
from dolfinx import fem, mesh

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.laws.rows import OPEN

E, NU, stress = scenes.E, scenes.NU, scenes.stress
BELOW, ABOVE = pairs.BELOW, pairs.ABOVE


def rectangle(comm, n, low, high, kind, jitter=0.0, rng=None, move=None):
    """Mesh of a rectangle and the tags BELOW and ABOVE of its horizontal edges."""
    axes = [np.linspace(0.0, 1.0, k + 1) for k in n]
    if jitter:
        axes[0][1:-1] += rng.uniform(-jitter, jitter, n[0] - 1) / n[0]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    first = (np.arange(n[0])[:, None] * (n[1] + 1) + np.arange(n[1])).ravel()[:, None]
    cells = first + [0, n[1] + 1, 1, n[1] + 2]
    if kind == "triangle":
        cells = np.concatenate([cells[:, [0, 1, 3]], cells[:, [0, 3, 2]]])
    x = np.asarray(low) + x * (np.asarray(high) - low)
    if comm.rank:
        x, cells = x[:0], cells[:0]
    domain = compat.create_mesh(comm, cells, x, kind)
    found = [
        mesh.locate_entities_boundary(domain, 1, lambda p, at=at: np.isclose(p[1], at[1]))
        for at in (low, high)
    ]
    values = np.repeat([BELOW, ABOVE], [len(f) for f in found]).astype(np.int32)
    facets = np.concatenate(found)
    order = np.argsort(facets)
    tags = mesh.meshtags(domain, 1, facets[order], values[order])
    if move is not None:
        gdim = 2
        domain.geometry.x[:, :gdim] = move(domain.geometry.x[:, :gdim])
    return domain, tags


def hold_all(V, where, value):
    """Prescribe all components where ``where`` holds; value(points (3, n)) gives them (gdim, n)."""
    u = fem.Function(V)
    u.interpolate(lambda p: value(p)[: V.mesh.geometry.dim])
    return [fem.dirichletbc(u, fem.locate_dofs_geometrical(V, where))]


class Pressed:
    """A block on a block: the lower one fixed at its base, the upper one moved at its top.

    Args:
        blocks: [(mesh, tags), (mesh, tags)], made by ``pairs.block`` or ``rectangle``.
        law: of the interface.
        top: function of points (3, n) that tells the nodes that are moved.
        base: the same for the fixed ones.
        stiffer: the upper block's modulus over the lower one's.
    """

    def __init__(
        self, blocks, law, top, base, swap=False, solver="auto", stiffer=1.0, **options
    ):  # fmt: skip
        self.spaces = [compat.function_space(d, shape=(d.geometry.dim,)) for d, _ in blocks]
        low, high = self.spaces
        self.motion = fem.Function(high)
        dofs = fem.locate_dofs_geometrical(high, top)
        bcs = hold_all(low, base, lambda p: 0.0 * p) + [fem.dirichletbc(self.motion, dofs)]
        forms = [(ufl.TrialFunction(V), ufl.TestFunction(V)) for V in self.spaces]
        sides = ((blocks[0][1], ABOVE), (blocks[1][1], BELOW))
        self.problem = llm.ContactProblem(
            [
                E * ufl.inner(stress(u), ufl.grad(w)) * ufl.dx
                for E, (u, w) in zip((1.0, stiffer), forms, strict=True)
            ],
            [
                ufl.inner(fem.Constant(V.mesh, np.zeros(V.mesh.geometry.dim)), w) * ufl.dx
                for V, (_, w) in zip(self.spaces, forms, strict=True)
            ],
            bcs=bcs,
            solver=solver,
            interfaces=[llm.Interface(None, sides[::-1] if swap else sides, law=law, **options)],
        )

    def move(self, value, increments=1):
        """Solve with the top moved by value(points (3, n)) -> (gdim, n)."""
        gdim = self.motion.function_space.mesh.geometry.dim
        self.motion.interpolate(lambda p: value(p)[:gdim])
        return self.problem.solve(increments=increments)


def random_pressed(comm, seed, swap=False, **options):
    """Two random blocks, law and motions of the top; see ``Pressed``.

    Returns:
        The scene and a list of motions.
    """
    rng = np.random.default_rng(seed)
    gdim = int(rng.choice([2, 3], p=[0.7, 0.3]))
    law = llm.Frictionless()
    if rng.random() < 0.6:
        law = llm.Coulomb(float(rng.choice([0.0, 0.05, 0.2, 0.5, 1.0, 1.5])))
    ratio = rng.uniform(1.0, 5.0)
    n0 = int(rng.integers(3, 10 if gdim == 2 else 5))
    n1 = int(min(max(2, round(n0 * ratio)), 30 if gdim == 2 else 12))
    counts = [n0, n1] if rng.random() < 0.5 else [n1, n0]
    gap = float(rng.choice([0.0, 0.02, -0.02]))
    tilt = float(rng.choice([0.0, 0.0, 0.02, -0.03]))
    bulge = float(rng.choice([0.0, 0.0, 0.05]))
    half, height = rng.uniform(0.3, 0.9), 1.0 + gap

    def shape(x):
        """The upper block's lower face: tilted and bulged."""
        x = x.copy()
        share = np.clip(1.0 - (x[:, -1] - height), 0.0, 1.0)
        x[:, -1] += share * (tilt * x[:, 0] + bulge * (x[:, 0] / half) ** 2)
        return x

    if gdim == 2:
        kinds = rng.choice(["quadrilateral", "triangle"], 2)
        low = rectangle(comm, (counts[0], 3), (-1.0, 0.0), (1.0, 1.0), kinds[0], 0.25, rng)
        high = rectangle(
            comm, (counts[1], 3), (-half, height), (half, height + 1.0), kinds[1], 0.25, rng, shape
        )
    else:
        kinds = rng.choice(["hexahedron", "tetrahedron"], 2)
        low = pairs.block(
            comm, (counts[0],) * 2 + (2,), (-1.0, -1.0, 0.0), (1.0, 1.0, 1.0), kinds[0],
            jitter=0.2, rng=rng,
        )  # fmt: skip
        high = pairs.block(
            comm, (counts[1],) * 2 + (2,), (-half, -half, height), (half, half, height + 1.0),
            kinds[1], jitter=0.2, rng=rng,
        )  # fmt: skip
        high[0].geometry.x[:] = shape(high[0].geometry.x)
    scene = Pressed(
        [low, high], law, lambda p: p[gdim - 1] > height + 0.999, lambda p: p[gdim - 1] < 1e-9,
        swap, **options,
    )  # fmt: skip
    motions = []
    for _ in range(3):
        down, turn = rng.uniform(0.0, 0.06), rng.uniform(-0.04, 0.04) * rng.choice([0.0, 1.0])
        drag = rng.uniform(-0.03, 0.03, gdim - 1) * rng.choice([0.0, 1.0])
        down += max(gap, 0.0) * rng.choice([0.0, 1.0])

        def motion(p, down=down, turn=turn, drag=drag):
            out = 0.0 * p
            out[: gdim - 1] = drag[:, None]
            out[gdim - 1] = turn * p[0] - down
            return out

        motions.append(motion)
    return scene, motions


def violations(problem) -> dict:
    """How far a solution is from each condition, scaled by the largest force and motion."""
    force = max(np.abs(s.normal_force).max(initial=0.0) for r in problem.results for s in r.sides)
    size = max(np.abs(s.u).max(initial=0.0) for r in problem.results for s in r.sides)
    size = max(size, 1e-300)
    stiff = problem.scale
    force = max(force, 1e-3 * stiff * size)
    worst = {"pull": 0.0, "overlap": 0.0, "product": 0.0, "balance": 0.0, "cone": 0.0}

    def note(name, value):
        worst[name] = max(worst[name], float(np.max(value, initial=0.0)))

    for geometry, result in zip(problem.geometries, problem.results, strict=True):
        mu = getattr(geometry.interface.law, "mu", 0.0)
        for side in result.sides:
            note("pull", -side.normal_force / force)
            note("overlap", -side.frame_gap / size)
            note("product", np.abs(side.normal_force * side.frame_gap) / (force * size))
            # Of what dies out beside contact, where the gap is large against it.
            faint = np.minimum(1e-3 * force, 0.1 * stiff * side.gap)
            over = np.abs(side.normal_force) - faint
            note("product", over[side.status == OPEN] / force)
        total = sum(s.force.sum(axis=0) for s in result.sides)
        note("balance", np.abs(total) / force)
        T = np.linalg.norm(result.frame_friction, axis=1)
        note("cone", (T - mu * np.maximum(result.frame_force, 0.0)) / force)
    worst["residual"] = problem.history[-1]["residual"]
    return worst
