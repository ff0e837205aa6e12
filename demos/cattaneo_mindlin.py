"""Cattaneo and Mindlin: two like cylinders pressed together, then loaded along the surface.

Under a tangential force Q < mu P the edges of the contact slip and its middle sticks:

    q(x) = mu p0 [sqrt(1 - x²/a²) - (c/a) sqrt(1 - x²/c²)],   c = a sqrt(1 - Q / (mu P)),

the second term for |x| < c only. The discs of ``hertz2d.py``: pressed in one load step, then Q in
equal ones. A couple on the diameters balances the moment of Q about the contact; without it the
discs would roll. A tenth of the load of ``hertz2d.py`` brings the discs near to half-spaces.

    mpirun -n 2 python demos/cattaneo_mindlin.py [--elements 32 47] [--steps N] [--plot DIR] ...
"""

import argparse
import json
from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from hertz2d import CONTACT, DIAMETER, LOAD, R, averages, fit, half_disc, hertz, hold, stress
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

MU = 0.2
P, Q = LOAD["cylinders"], 0.05851 * 2 * R  # per unit of thickness


def theory(load=1.0):
    """a, p0, stick half-width c, and the tangential traction as a function of x."""
    a, p0 = hertz("cylinders", load)
    c = a * np.sqrt(1 - Q / (MU * P))

    def traction(x):
        roots = [np.sqrt(np.maximum(1 - (x / w) ** 2, 0.0)) for w in (a, c)]
        return MU * p0 * (roots[0] - c / a * roots[1])

    return a, p0, c, traction


# ## The discs, both loaded alike
class Discs:
    """The problem, with ``options`` of ``ContactProblem``, and its load; ``tangential`` is Q over
    the diameter [force / area]."""

    def __init__(
        self, elements=(16, 23), load=1.0, method="newton", comm=MPI.COMM_WORLD, **options
    ):
        forms, loads, bcs, sides = [], [], [], []
        self.load, self.tangential = load, []
        for n, up in zip(elements, (1, -1)):
            domain, tags = half_disc(comm, theory(load)[0], n, up)
            V = compat.function_space(domain, shape=(2,))
            u, w, x = ufl.TrialFunction(V), ufl.TestFunction(V), ufl.SpatialCoordinate(domain)
            ds = ufl.Measure("ds", domain=domain, subdomain_data=tags)
            p, q = fem.Constant(domain, load * P / (2 * R)), fem.Constant(domain, 0.0)
            # q at the height R has the moment that the linear pressure 3 q x / R takes back.
            traction = ufl.as_vector((q, -(p - 3 * q * x[0] / R)))
            forms.append(ufl.inner(stress(u), ufl.grad(w)) * ufl.dx)
            loads.append(up * ufl.inner(traction, w) * ds(DIAMETER))
            sides.append((tags, CONTACT))
            self.tangential.append(q)
            if up < 0:  # holds rigid motions, carries nothing and lets the disc not turn
                for k, end in ((0, 0.0), (1, -R), (1, R)):
                    at = (end, -R)
                    bcs.append(hold(V, k, lambda x, at=at: np.isclose(x[:2].T, at).all(axis=1)))
        law = llm.Coulomb(MU, method=method)
        interface = llm.Interface(None, tuple(sides), law=law)
        self.problem = llm.ContactProblem(forms, loads, bcs=bcs, interfaces=[interface], **options)

    def run(self, steps=4):
        """Press, then drag; returns the iterations of each load step."""
        iterations = []
        for share in np.linspace(0.0, 1.0, steps + 1):
            for q in self.tangential:
                q.value = share * self.load * Q / (2 * R)
            self.problem.solve()
            iterations.append(len(self.problem.history))
        return iterations


# ## Figures
def figures(contact, elements, load=1.0):
    """Stick half-width, tangential traction and friction against theory."""
    a, p0, c, traction = theory(load)
    result = contact.results[0]
    x, N, force = result.x[:, 0], result.frame_force, np.abs(result.frame_friction[:, 0])
    sticks, exact = (N > 0) & (force < MU * N * (1 - 1e-6)), averages(x, traction)
    peak, width = fit(x, result.pressure)
    return {
        "stick half-width / c": np.ptp(x[sticks]) / 2 / c, "element / c": a / min(elements) / c,
        "L2 error of q": np.linalg.norm(np.abs(result.traction[:, 0]) - exact)
        / np.linalg.norm(exact),
        "friction / Q": force.sum() / (load * Q), "peak / p0": peak / p0,
        "half-width / a": width / a, "beyond mu N": np.max(force - MU * N) / (MU * N.max()),
    }  # fmt: skip


def picture(contact, load, path):
    a, p0, _, traction = theory(load)
    result, x = contact.results[0], np.linspace(-1, 1, 1000)
    lines = [
        ("μ p, Hertz", "k:", x, np.sqrt(1 - x**2)),
        ("q, Cattaneo and Mindlin", "k-", x, traction(a * x) / (MU * p0)),
        ("μ p, frame", "C0+", result.x[:, 0] / a, result.pressure / p0),
        ("q, frame", "C1.", result.x[:, 0] / a, np.abs(result.traction[:, 0]) / (MU * p0)),
    ]
    plot.curves(lines, path, xlabel="x / a", ylabel="traction over μ p0")


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--elements", type=int, nargs=2, default=(32, 47), metavar="N")
    parser.add_argument("--steps", type=int, default=4, help="of the tangential force")
    parser.add_argument("--load", type=float, default=0.1, help="factor on P and Q")
    parser.add_argument("--method", choices=["newton", "switch"], default="newton")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    discs = Discs(args.elements, args.load, args.method)
    iterations = discs.run(args.steps)
    found = figures(discs.problem, args.elements, args.load)
    if MPI.COMM_WORLD.rank == 0:
        print(f"{discs.problem}\n\niterations per load step: {iterations}")
        print("\n".join(f"{name:20}{value:12.5g}" for name, value in found.items()))
        if args.json:
            args.json.write_text(json.dumps(found | {"iterations": iterations}) + "\n")
    if args.plot:
        picture(discs.problem, args.load, args.plot / "cattaneo_mindlin.png")
    return discs.problem, found, iterations


if __name__ == "__main__":
    main()
