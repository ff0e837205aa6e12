"""An O-ring of viscoelastic rubber: squeezed, held, let go a little, until it seals again.

The ring of ``rubber_seal.py``, whose stress S(C) fades with time to the share G of itself,

    S(t) = G S_el(t) + Q(t),   Q' = (1 - G) S_el' - Q / tau,

is squeezed at once and held: nothing moves then, and its force falls as g(t) = G + (1 - G)
exp(-t / tau), whatever the shape. Then the plates go back so far that the ring, which is slow,
loses them, comes back to them and in the end presses them as an elastic ring with G times the
moduli. Q and the elastic stress before are values at the points of quadrature.

    mpirun -n 2 python demos/viscoelastic_seal.py [--refine N] [--squeeze C] [--plot DIR] ...
"""

import argparse
import json
from pathlib import Path

import numpy as np
import rubber_seal
import ufl
from dolfinx import fem
from finite_patch import lame
from hertz2d import hold
from mpi4py import MPI
from rubber_seal import DIAMETER, MIDDLE, POISSON, SKIN, YOUNG

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

LASTS, TAU, AT_ONCE, DEGREE = 0.4, 1.0, 1e-6, 3  # G, s, s, of the quadrature


class Seal:
    """The right half of the ring between two plates; ``share`` of S that does not fade, 1: none."""

    def __init__(self, refine=1, share=LASTS, comm=MPI.COMM_WORLD):
        domain, tags = rubber_seal.seal(comm, refine)
        V = compat.function_space(domain, shape=(2,))
        Z = compat.quadrature_space(domain, DEGREE, (2, 2))
        u, viscous, before = fem.Function(V), fem.Function(Z, name="Q"), fem.Function(Z, name="S")
        self.dt = fem.Constant(domain, AT_ONCE)
        mu, lam = (fem.Constant(domain, value) for value in lame(YOUNG, POISSON))
        F = ufl.Identity(2) + ufl.grad(u)
        inverse = ufl.inv(F.T * F)
        elastic = mu * (ufl.Identity(2) - inverse) + lam * ufl.ln(ufl.det(F)) * inverse
        x = self.dt / TAU
        now = ufl.exp(-x) * viscous
        now += (1.0 - share) * (1.0 - ufl.exp(-x)) / x * (elastic - before)
        dx = ufl.dx(domain, metadata={"quadrature_degree": DEGREE})
        residual = ufl.inner(F * (share * elastic + now), ufl.grad(ufl.TestFunction(V))) * dx
        self.memory = llm.Evolution({viscous: now, before: elastic})
        middle = fem.locate_dofs_topological(V.sub(0), 1, tags.indices[tags.values == MIDDLE])
        ends = [llm.RigidPlane((0.0, s * DIAMETER / 2), (0.0, -s)) for s in (-1.0, 1.0)]
        self.plates = ends
        self.contact = llm.NonlinearContactProblem(
            residual,
            u,
            bcs=[
                fem.dirichletbc(0.0, middle, V.sub(0)),
                hold(V, 1, lambda x: np.hypot(x[0], x[1]) < 1e-9),
            ],
            interfaces=[llm.Interface(tags, (SKIN, p), law=llm.Frictionless()) for p in ends],
        )
        self.t, self.rows = 0.0, []

    def go(self, squeeze, dt, files=None):
        """A step in time: force of both halves on the upper plate."""
        self.dt.value = dt
        for way, plate in zip((0.5, -0.5), self.plates, strict=True):
            plate.displacement = (0.0, way * squeeze * DIAMETER)
        self.contact.solve(accepted=self.memory, dt=self.dt)
        self.t += dt
        force = 2.0 * float(self.contact.results[1].sides[0].normal_force.sum())
        self.rows.append((self.t, force, squeeze))
        if files:
            files.write(self.t)
        return force


def run(seal, squeeze, back, steps, files=None):
    """Squeezed at once, held for 3 tau, let go for 12 tau; figures, and rows of the holding and of
    what follows."""
    for c in squeeze * np.arange(1, 5) / 4:
        first = seal.go(c, AT_ONCE, files)
    begin = seal.t
    for dt in np.diff(np.geomspace(0.03 * TAU, 3.03 * TAU, steps + 1)):
        seal.go(squeeze, dt, files)
    held = np.array(seal.rows[3:])
    g = LASTS + (1.0 - LASTS) * np.exp(-(held[:, 0] - begin) / TAU)
    seal.go(squeeze - back, AT_ONCE, files)
    for dt in np.diff(np.geomspace(0.1 * TAU, 12.1 * TAU, steps + 1)):
        last = seal.go(squeeze - back, dt, files)
    after = np.array(seal.rows[len(held) + 3 :])
    sealed = after[:, 1] > 0.0
    found = {
        "force": first, "relaxation": float(np.abs(held[:, 1] / first / g - 1.0).max()),
        "open": float(after[np.argmax(sealed), 0] - after[0, 0]), "last": last,
    }  # fmt: skip
    return found, held, after


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--refine", type=int, default=1, metavar="N")
    parser.add_argument("--squeeze", type=float, default=0.2, metavar="C", help="of the diameter")
    parser.add_argument("--back", type=float, default=0.12, metavar="C", help="of the diameter")
    parser.add_argument("--steps", type=int, default=16, help="of each of the two times")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    parser.add_argument("--output", type=Path, metavar="DIR", help="time series for ParaView")
    args = parser.parse_args(arguments)
    seal, elastic = Seal(args.refine), Seal(args.refine, 1.0)
    for c in (args.squeeze - args.back) * np.arange(1, 3) / 2:
        rests = LASTS * elastic.go(c, AT_ONCE)
    if args.output:
        with llm.post.LoadSteps(seal.contact, args.output) as files:
            found, held, after = run(seal, args.squeeze, args.back, args.steps, files)
    else:
        found, held, after = run(seal, args.squeeze, args.back, args.steps)
    found["last"] /= rests
    if MPI.COMM_WORLD.rank == 0:
        print(seal.contact)
        print(f"force when squeezed:                     {found['force']:.4f} N / mm")
        print(f"force while held, off g(t) by at most:   {found['relaxation']:.1e}")
        print(f"open after the plates went back, for:    {found['open']:.2f} tau")
        print(f"force in the end over the elastic ring's: {found['last']:.5f}")
        if args.json:
            args.json.write_text(json.dumps(found) + "\n")
    if args.plot:
        seal.contact.plot(args.plot)
        t = np.linspace(0.0, 3.0, 61)
        theory = found["force"] * (LASTS + (1.0 - LASTS) * np.exp(-t))
        every = np.vstack([held, after])
        lines = [("force on the plate", "C0.-", every[:, 0] / TAU, every[:, 1])]
        lines += [("theory, held", "k:", t, theory)]
        lines += [("elastic, in the end", "C1--", [3.0, every[-1, 0]], [rests, rests])]
        label = {"xlabel": "time / tau", "ylabel": "force [N / mm]"}
        plot.curves(lines, args.plot / "viscoelastic_seal.png", **label)
    return found


if __name__ == "__main__":
    main()
