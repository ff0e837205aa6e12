"""Random walls: sizes, bonds, missing blocks, laws by joint, side loads, cells; both forms.

python tests/shared/wall_campaign.py 1-100. Judged by K u - f and positions alone.
"""

import sys
import time

import numpy as np
import ufl
import wall_scenes as walls
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm

LAWS = [llm.Tied(), llm.Frictionless(), llm.Coulomb(0.6)]
KINDS = {2: ["quadrilateral", "triangle"], 3: ["hexahedron", "tetrahedron"]}


def scene(seed):
    """A wall, its load, and the law of each joint."""
    rng = np.random.default_rng(seed)
    gdim = 2 if rng.random() < 0.8 else 3
    rows, columns = rng.integers(2, 4 if gdim == 2 else 3), rng.integers(1, 4 if gdim == 2 else 3)
    bond = rng.choice([0.0, 0.5, 0.3, rng.uniform(0.1, 0.9)])
    blocks = walls.courses(int(rows), int(columns), bond, depth=0.7 if gdim == 3 else None)
    if rng.random() < 0.4:  # one block of the courses above the base is missing
        above = np.flatnonzero(blocks[:, 0, 1] > 0.0)
        blocks = np.delete(blocks, rng.choice(above), axis=0) if len(above) > 1 else blocks
    counts = rng.integers(1, 5 if gdim == 2 else 4, (len(blocks), gdim))
    wall = walls.Wall(MPI.COMM_SELF, blocks, counts, rng.choice(KINDS[gdim]))
    chosen = LAWS if rng.random() < 0.6 else [LAWS[rng.integers(3)]]
    laws = [chosen[k] for k in rng.integers(0, len(chosen), len(wall.faces))]
    load = np.zeros(gdim)
    load[:2] = rng.choice([0.0, 0.05, 0.2]), -1.0
    return wall, laws, load


def solved(wall, laws, load, solver):
    """u, forces at all nodes per joint, and violations {name: relative size}; or an error."""
    a, _ = wall.forms()
    L = ufl.inner(fem.Constant(wall.domain, load), ufl.TestFunction(wall.V)) * ufl.dx
    joints = [
        llm.Interface(i.facet_tags, i.sides, law=law)
        for i, law in zip(wall.interfaces(), laws, strict=True)
    ]
    with llm.ContactProblem(a, L, bcs=wall.base(), interfaces=joints, solver=solver) as problem:
        u = problem.solve().x.array.reshape(-1, wall.gdim)
        left = problem.bulk.force(u.ravel()).reshape(u.shape)  # f - K u
        size, moved = np.abs(left).max(), np.abs(u).max()
        worst = dict.fromkeys(["balance", "pull", "cone", "work", "overlap", "blocks"], 0.0)
        area = (wall.blocks[:, 1] - wall.blocks[:, 0]).prod(axis=1)
        at_blocks = area[:, None] * load

        def note(name, value):
            worst[name] = max(worst[name], float(np.max(value, initial=0.0)))

        for k, (i, axis, j) in enumerate(wall.faces):
            total, work, gap = 0.0, 0.0, 0.0
            law, geometry = laws[k], problem.geometries[k]
            for side, pairs, sign in zip(
                problem.results[k].sides, geometry.pairs, (1.0, -1.0), strict=True
            ):
                nodes, force = pairs.dofs, side.force
                left[nodes] -= force
                normal = sign * force[:, axis]
                if not isinstance(law, llm.Tied):
                    note("pull", -normal / size)
                    work += (force[:, axis] * u[nodes, axis]).sum()
                    gap -= sign * (pairs.forces @ u[nodes, axis])
                    along = np.delete(force, axis, axis=1)
                    limit = getattr(law, "mu", 0.0) * normal.sum()
                    note("cone", (np.linalg.norm(along.sum(axis=0)) - limit) / size)
                else:
                    work += (force * u[nodes]).sum()
                total += sign * force.sum(axis=0)
            note("work", abs(work) / (size * moved))
            note("overlap", -gap / (geometry.area * moved))
            at_blocks[i] -= 0.5 * total
            at_blocks[j] += 0.5 * total
        free = wall.blocks[:, 0, 1] > 0.0
        above = wall.V.tabulate_dof_coordinates()[: len(left), 1] > 1e-9
        note("balance", np.abs(left[above]) / size)
        note("blocks", np.abs(at_blocks[free]) / size)
        return u.copy(), worst


def verdict(seed):
    """Words: "right" or what is wrong."""
    made, found, told = scene(seed), [], []
    for solver in ("saddle", "condensed"):
        try:
            u, worst = solved(*made, solver)
        except llm.ContactError as error:
            told.append(str(error))
            continue
        bad = {name: f"{value:.1e}" for name, value in worst.items() if value > 1e-8}
        if bad:
            return f"{solver}: {bad}"
        found.append(u)
    if len(found) == 1:
        return f"one form alone raises: {told[0]}"
    if told:
        falls = all("balance the load" in words for words in told)
        return "right: falls" if falls else f"raises: {told}"
    if any(getattr(law, "mu", 0.0) for law in made[1]):  # more than one state may be right
        return "right"
    apart = np.abs(found[0] - found[1]).max() / np.abs(found).max()
    return "right" if apart < 1e-7 else f"forms differ by {apart:.1e}"


if __name__ == "__main__":
    first, last = map(int, sys.argv[1].split("-"))
    for seed in range(first, last + 1):
        start = time.process_time()
        print(seed, verdict(seed), f"({time.process_time() - start:.1f} s)", flush=True)
