"""Two contact laws of one's own: a glue that breaks, and a soft layer that stiffens.

Each is a class on ``llm.Law`` that tells forces at the nodes where it holds, and nothing else in
the package knows of it. Two blocks of meshes that do not match are pulled apart or pressed together
by their ends; they meet in a plane that may be inclined to the pull (a scarf joint), so that the
glue is under tension and shear. The stress is uniform, whatever the meshes, and known in closed
form: with the pull U of the ends, q and the inclination θ,

    U = σ H / E + q Δ,   q σ cos θ = T(Δ)    glue, T(Δ) rises, falls, and ends
    U = σ H / E - o,     -σ = p(o)           soft layer, o: overlap

Then two glued beams are peeled from each other. Griffith's balance of energy with Bernoulli's beams
(no shear, clamped at the tip, so that it is near, not exact) gives the force while the crack grows.

    mpirun -n 2 python demos/own_law.py [--dim 3] [--elements 4 6] [--angle 30] [--solver ...]
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem, mesh
from hertz2d import hold
from mpi4py import MPI
from scipy.optimize import brentq

import dolfinx_llm as llm
from dolfinx_llm import compat

E, NU, HEIGHT = 1000.0, 0.3, 2.0
BOTTOM, TOP = 1, 2
SCENES = ("glue", "inclined", "soft", "peel")


# ## The laws
@dataclass(frozen=True)
class Glue(llm.Law):
    """Traction rises with the opening Δ = (δ_n² + ratio δ_t²)^½ up to ``first``, falls to 0 at
    ``last``, and then the surfaces are free; pressed together they do not weaken."""

    k: float = 4000.0  # [force / area / length]
    ratio: float = 0.5  # of the tangential stiffness
    first: float = 0.001  # [length]
    last: float = 0.0145
    slips, gives, closes_gap = True, True, False

    def start(self, nodes):
        return {"largest": np.zeros(len(nodes.x))}  # opening so far

    def opening(self, nodes):
        weight = np.full(nodes.jump.shape, self.ratio)
        weight[:, -1] = nodes.jump[:, -1] < 0.0  # apart
        return np.sqrt((weight * nodes.jump**2).sum(axis=1)), weight

    def end_step(self, nodes):
        return {"largest": np.maximum(nodes.history["largest"], self.opening(nodes)[0])}

    def rows(self, nodes):
        now, weight = self.opening(nodes)
        before = nodes.history["largest"]
        felt = np.clip(np.maximum(before, now), self.first, self.last)
        share = self.first * (self.last - felt) / (felt * (self.last - self.first))  # left
        falls = (now > before * (1.0 + 1e-9)) & (now > self.first) & (now < self.last)
        slope = np.where(falls, -self.first * self.last / (felt**2 * (self.last - self.first)), 0.0)
        pull = weight * nodes.jump
        K = share[:, None, None] * weight[:, :, None] * np.eye(pull.shape[1])
        K += (slope / np.maximum(now, 1e-300))[:, None, None] * pull[:, :, None] * pull[:, None, :]
        force = share[:, None] * pull
        pressed = nodes.jump[:, -1] >= 0.0
        K[pressed, -1, -1] = 1.0
        force[:, -1] = np.where(pressed, nodes.jump[:, -1], force[:, -1])
        k = self.k * nodes.area
        return llm.LawRows.springs(
            nodes, k[:, None] * force, k[:, None, None] * K, holds=before < self.last
        )


@dataclass(frozen=True)
class Soft(llm.Law):
    """Pressure over overlap o as of rough surfaces: p = p0 (exp(o / h) - 1), without friction."""

    p0: float = 2.0  # [force / area]
    h: float = 0.001  # [length]
    components, gives = "normal", True

    def rows(self, nodes):
        p = nodes.N / nodes.area
        pressed = np.maximum(p, 0.0)
        compliance = self.h / (self.p0 + pressed)
        # Iterates may pull: there the law goes on along its tangent.
        overlap = self.h * np.log1p(pressed / self.p0) + compliance * np.minimum(p, 0.0)
        return llm.LawRows.layer(nodes, overlap[:, None], (compliance / nodes.area)[:, None])


# ## Two blocks
def block(comm, dim, n, upper, slope):
    """Mesh of the lower or the upper half of a unit column, and tags of BOTTOM and TOP."""
    cells, low = [n] * dim, float(upper)
    corners = [[0.0] * (dim - 1) + [low], [1.0] * (dim - 1) + [low + 1.0]]
    make, kind = {
        2: (mesh.create_rectangle, mesh.CellType.quadrilateral),
        3: (mesh.create_box, mesh.CellType.hexahedron),
    }[dim]
    domain = make(comm, corners, cells, kind)
    found = [
        mesh.locate_entities_boundary(domain, dim - 1, lambda x, z=z: np.isclose(x[dim - 1], z))
        for z in (low, low + 1.0)
    ]
    values = np.repeat([BOTTOM, TOP], [len(f) for f in found]).astype(np.int32)
    order = np.argsort(np.concatenate(found))
    tags = mesh.meshtags(domain, dim - 1, np.concatenate(found)[order], values[order])
    x = domain.geometry.x
    z, tilt = x[:, dim - 1], slope * (x[:, 0] - 0.5)
    x[:, dim - 1] = 2.0 - (2.0 - z) * (1.0 - tilt) if upper else z * (1.0 + tilt)
    return domain, tags


def problem(spaces, bcs, sides, law, solver, interfaces=None):
    """Elastic bodies without loads."""
    forms, loads = [], []
    for V in spaces:
        u, w, dim = ufl.TrialFunction(V), ufl.TestFunction(V), V.mesh.geometry.dim
        eps = ufl.sym(ufl.grad(u))
        sigma = E / (1 + NU) * (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(dim))
        forms.append(ufl.inner(sigma, ufl.grad(w)) * ufl.dx)
        loads.append(ufl.inner(fem.Constant(V.mesh, (0.0,) * dim), w) * ufl.dx)
    interfaces = interfaces or llm.Interface(None, sides, law=law)
    return llm.ContactProblem(forms, loads, bcs=bcs, interfaces=interfaces, solver=solver)


class Column:
    """The problem; ``pull`` moves its upper end [length]."""

    def __init__(self, law, dim=2, elements=(4, 6), angle=0.0, solver="auto", slides=False):
        slope, comm = np.tan(np.radians(angle)), MPI.COMM_WORLD
        bodies = [block(comm, dim, n, k == 1, slope) for k, n in enumerate(elements)]
        spaces = [compat.function_space(domain, shape=(dim,)) for domain, _ in bodies]
        self.top = hold(spaces[1], dim - 1, lambda x: np.isclose(x[dim - 1], 2.0))
        bcs = [self.top, hold(spaces[0], dim - 1, lambda x: np.isclose(x[dim - 1], 0.0))]
        for V, z in ((spaces[0], 0.0), (spaces[1], 2.0))[: 1 if slides else 2]:
            for k in range(dim - 1):  # against sliding and turning, at a corner and one beside it
                at = [z if i == dim - 1 else 0.0 for i in range(3)]
                bcs.append(hold(V, k, lambda x, at=at: near(x, at)))
                if k == 1:
                    bcs.append(hold(V, k, lambda x, at=at: near(x, [1.0, *at[1:]])))
        sides = ((bodies[0][1], TOP), (bodies[1][1], BOTTOM))
        self.problem = problem(spaces, bcs, sides, law, solver)

    def pull(self, distance):
        """One load step; stress in the column, and by how much the traction is not uniform."""
        self.top.g.x.array[:] = distance
        self.problem.solve()
        result = self.problem.results[0]
        traction = np.column_stack([result.pressure, result.traction])
        return {
            "U": distance, "stress": -result.resultant[-1],
            "uneven": float(np.ptp(traction, axis=0).max()),
            "iterations": len(self.problem.history),
        }  # fmt: skip


def near(x, at):
    """Whether points (3, n) are at a corner."""
    return np.all([np.isclose(x[i], at[i]) for i in range(3)], axis=0)


# ## Closed forms
def stress_of(law, U, dim, angle, largest=0.0):
    """Stress for a pull U, and the largest opening of the glue then."""
    compliance = HEIGHT / (E / (1 - NU**2) if dim == 2 else E)
    if isinstance(law, Soft):
        if U >= 0.0:
            return 0.0, 0.0
        below = U / compliance
        return brentq(lambda s: U - s * compliance + law.h * np.log1p(-s / law.p0), below, 0.0,
                      xtol=1e-16, rtol=1e-15), 0.0  # fmt: skip
    if U < 0.0:
        return U / (compliance + 1.0 / law.k), largest
    cos, sin = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    q = np.sqrt(cos**2 + sin**2 / law.ratio)

    def traction(opening):
        worst = np.clip(max(opening, largest), law.first, law.last)
        share = law.first * (law.last - worst) / (worst * (law.last - law.first))
        return law.k * share * opening

    def left(opening):
        return traction(opening) * compliance / (q * cos) + q * opening - U

    opening = brentq(left, 0.0, U / q + 1e-9, xtol=1e-16, rtol=1e-15)
    return traction(opening) / (q * cos), max(largest, opening)


def run(law, dim=2, elements=(4, 6), angle=0.0, solver="auto"):
    """The form of the system, and rows of all load steps with the stress by the closed form."""
    pulls = [0.004, 0.011, 0.005, 0.013, 0.016, -0.003, 0.005]  # breaks in the fifth
    if angle:
        pulls = [0.004, 0.011, 0.005, 0.013]
    if isinstance(law, Soft):
        pulls = [-0.002, -0.008, 0.001, -0.02]
    column = Column(law, dim, elements, angle, solver, slides=angle > 0.0)
    rows, largest = [], 0.0
    for U in pulls:
        row = column.pull(U)
        row["closed form"], largest = stress_of(law, U, dim, angle, largest)
        rows.append(row)
    form = column.problem.form
    column.problem.destroy()
    return form, rows


def peel(elements=(60, 40), length=10.0, crack=3.0, distance=1.6, steps=8):
    """Two beams of height 1 glued beyond x = ``crack``, pulled apart at x = 0: rows of load steps.

    With P a = M = (G_c E' / 12)^½ while the crack grows and d = 8 P a³ / E', P² = 8 M³ / (E' d).
    """
    law, bodies = Glue(k=1e4, first=0.0005, last=0.08), []
    for n, high, low in zip(elements, (4, 3), (-1.0, 0.0), strict=True):
        corners = [[0.0, low], [length, low + 1.0]]
        domain = mesh.create_rectangle(
            MPI.COMM_WORLD, corners, [n, high], mesh.CellType.quadrilateral
        )
        glued = mesh.locate_entities_boundary(
            domain, 1, lambda x: np.isclose(x[1], 0.0) & (x[0] > crack - 1e-9)
        )
        ones = np.ones(len(glued), dtype=np.int32)
        bodies.append((domain, mesh.meshtags(domain, 1, np.sort(glued), ones)))
    spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in bodies]
    ends = [
        hold(V, 1, lambda x, y=y: np.isclose(x[0], 0.0) & np.isclose(x[1], y))
        for V, y in zip(spaces, (-1.0, 1.0), strict=True)
    ]
    bcs = ends + [hold(V, 0, lambda x: np.isclose(x[0], length)) for V in spaces]
    beams = problem(spaces, bcs, [(tags, 1) for _, tags in bodies], law, "auto")
    stiffness, rows = E / (1 - NU**2), []
    M = np.sqrt(0.5 * law.k * law.first * law.last * stiffness / 12.0)
    for d in distance * np.arange(1, steps + 1) / steps:
        ends[0].g.x.array[:], ends[1].g.x.array[:] = -d / 2, d / 2
        beams.solve()
        result = beams.results[0]
        rows.append({
            "d": float(d), "force": float(-result.resultant[1]), "parted": int(
                (result.frame_status == 0).sum()),
            "Griffith": float(np.sqrt(8.0 * M**3 / (stiffness * d))),
            "iterations": len(beams.history),
        })  # fmt: skip
    beams.destroy()
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--dim", type=int, default=2, choices=(2, 3))
    parser.add_argument("--elements", type=int, nargs=2, default=(4, 6), metavar=("LOWER", "UPPER"))
    parser.add_argument("--angle", type=float, default=30.0, help="of the scarf joint, in degrees")
    parser.add_argument("--solver", default="auto", choices=("auto", "saddle", "condensed"))
    parser.add_argument("--scenes", nargs="+", default=SCENES, choices=SCENES)
    parser.add_argument("--json", action="store_true", help="print figures as JSON")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args()
    figures, shows = {}, MPI.COMM_WORLD.rank == 0 and not args.json
    for name, law, angle in (
        ("glue", Glue(), 0.0), ("inclined", Glue(), args.angle), ("soft", Soft(), 0.0)
    ):  # fmt: skip
        if name in args.scenes:
            form, figures[name] = run(law, args.dim, args.elements, angle, args.solver)
            if shows:
                print(f"{name}: {law}, form {form}")
                for row in figures[name]:
                    print("  {U:7.4f}: stress {stress:11.7f}, closed form {closed form:11.7f}"
                          ", uneven {uneven:.0e}, {iterations} iterations".format(**row)
                    )  # fmt: skip
    if "peel" in args.scenes:
        figures["peel"] = peel()
        if shows:
            print("peel")
            for row in figures["peel"]:
                print("  ends apart by {d:.1f}: force {force:.4f}, Griffith {Griffith:.4f}, "
                      "{parted} nodes parted, {iterations} iterations".format(**row))  # fmt: skip
    if args.plot:
        lines = []
        for name, rows in figures.items():
            keys = ("d", "force", "Griffith") if name == "peel" else ("U", "stress", "closed form")
            x, found, known = ([row[key] for row in rows] for key in keys)
            lines.append([(f"{name}: {keys[1]}", "C0o", x, found), (keys[2], "k+", x, known)])
        path = args.plot / "own_law.png"
        llm.plot.curves(lines, path, xlabel="motion of the ends")
    if args.json and MPI.COMM_WORLD.rank == 0:
        print(json.dumps(figures))


if __name__ == "__main__":
    main()
