"""Shrink fit by cooling: a hot ring is put over a cold one, cools, presses, and conducts the more
heat the more it presses. Pressure and heat against the closed form.

Bore and outer face have given temperatures; that of the outer face falls in steps. Until the rings
touch no heat goes across; then the conductance of the interface is h = c p, with the pressure p.
Heat and stress are solved by turns, on the same mesh and the same interface, until neither changes.

With mean temperatures t_1, t_2 of the rings (plane stress) the interference is δ + α B (t_1 - t_2),
which gives Lamé's pressure; the flow q per radian goes through rings and interface in a row,

    (T_2 - T_1) / q = ln(B / A) / k + 1 / (h B) + ln(C / B) / k.

    mpirun -n 2 python demos/shrink_fit_cooling.py [--refine N] [--plot DIR] [--json FILE]
"""

import argparse
import json
from pathlib import Path

import numpy as np
import shrink_fit as fit
import ufl
from dolfinx import fem
from mpi4py import MPI
from shrink_fit import DELTA, NU, A, B, C, E

import dolfinx_llm as llm
from dolfinx_llm import compat, plot

# Millimetres, newtons, seconds, kelvin
ALPHA, K, CONDUCTS = 1.2e-5, 50.0, 0.05  # h = 0.05 N/(s mm K) per N/mm² of pressure
COLD, STEPS = 20.0, (120.0, 65.0, 50.0, 35.0)  # temperatures of the bore, of the outer face


# ## Two problems on one mesh
def expansion(V, T):
    """Load of the stress that would hold the rings at their size, plane stress."""
    held = E / (1 - NU) * ALPHA * (T - COLD)
    return held * ufl.div(ufl.TestFunction(V)) * ufl.dx


def problems(mesh, tags):
    """Contact of the rings, heat in them, the temperature, and that of the outer face."""
    V, W = compat.function_space(mesh, shape=(2,)), compat.function_space(mesh)
    T = fem.Function(W)
    T.x.array[:] = COLD
    sides = fit.INNER_FACE, fit.OUTER_FACE
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    contact = llm.ContactProblem(
        ufl.inner(fit.stress(u), ufl.sym(ufl.grad(w))) * ufl.dx,
        expansion(V, T),
        bcs=fit.symmetry(V),
        interfaces=llm.Interface(tags, sides, law=llm.Frictionless()),
    )
    t, v = ufl.TrialFunction(W), ufl.TestFunction(W)
    faces = [fem.locate_dofs_geometrical(W, lambda x, r=r: np.isclose(np.hypot(x[0], x[1]), r))
             for r in (A, C)]  # fmt: skip
    values = [fem.Function(W), fem.Function(W)]
    values[0].x.array[:] = COLD
    law = llm.Conductance(lambda x: CONDUCTS * contact.results[0].pressure_at(x))
    heat = llm.ContactProblem(
        K * ufl.inner(ufl.grad(t), ufl.grad(v)) * ufl.dx,
        fem.Constant(mesh, 0.0) * v * ufl.dx,
        bcs=[fem.dirichletbc(value, dofs) for value, dofs in zip(values, faces, strict=True)],
        interfaces=llm.Interface(tags, sides, law=law),
    )
    return contact, heat, T, values[1]


def equilibrium(contact, heat, T, most=100):
    """Heat and stress by turns, until the temperature changes by 1e-9 of its range; how often."""
    for turn in range(1, most + 1):
        before = T.x.array.copy()
        T.x.array[:] = heat.solve().x.array
        change = heat.comm.allreduce(np.abs(T.x.array - before).max(initial=0.0), op=MPI.MAX)
        contact.solve()
        if change <= 1e-7:
            return turn
    raise RuntimeError(f"the temperature still changes by {change:.1e}")


# ## Closed form
def mean(inner, outer, low, high):
    """Mean over a ring of the temperature between two of its faces, a + b ln r."""
    b = (outer - inner) / np.log(high / low)
    whole = (high**2 * np.log(high / low) - 0.5 * (high**2 - low**2)) / (high**2 - low**2)
    return inner + b * whole


def closed_form(outer, pressure):
    """Pressure, and flow from the outer to the inner ring per radian, from a pressure on."""
    for _ in range(10000):
        q = 0.0
        if pressure > 0.0:
            resistance = np.log(C / A) / K + 1.0 / (CONDUCTS * pressure * B)
            q = (outer - COLD) / resistance
        t_1 = mean(COLD, COLD + q * np.log(B / A) / K, A, B)
        t_2 = mean(outer - q * np.log(C / B) / K, outer, B, C)
        before = pressure
        pressure = max(fit.lame() * (1.0 + ALPHA * B * (t_1 - t_2) / DELTA), 0.0)
        if abs(pressure - before) <= 1e-12 * fit.lame():
            return pressure, q
    raise RuntimeError("no equilibrium")


def run(refine=1, steps=STEPS):
    """Rows of the steps, pressure and flow of both, and how many turns they took; the contact
    problem and the temperature at the end."""
    mesh, cells, tags = fit.rings(MPI.COMM_WORLD, refine)
    contact, heat, T, outside = problems(mesh, tags)
    hot = compat.cell_dofs(T.function_space)[cells.indices[cells.values == fit.OUTER]]
    T.x.array[hot.ravel()] = steps[0]
    contact.solve()
    rows, pressure = [], 0.0
    for outside.x.array[:] in steps:
        turns = equilibrium(contact, heat, T)
        found, flows = contact.results[0].pressure, heat.results[0].sides
        pressure, q = closed_form(outside.x.array[0], pressure)
        rows.append({
            "outer face": float(outside.x.array[0]), "turns": turns,
            "pressure": float(found.mean()), "uneven": float(np.ptp(found)),
            "flow": float(2.0 / np.pi * flows[1].force.sum()),
            "left": float(sum(side.force.sum() for side in flows)),
            "closed form": {"pressure": pressure, "flow": q},
        })  # fmt: skip
    return rows, contact, T


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--refine", type=int, default=1, metavar="N")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--plot", type=Path, metavar="DIR")
    args = parser.parse_args(arguments)
    rows, contact, T = run(args.refine)
    if MPI.COMM_WORLD.rank == 0:
        for row in rows:
            print("outer face {outer face:5.1f}: pressure {pressure:7.4f} (closed form {0:7.4f}), "
                  "flow per radian {flow:8.3f} ({1:8.3f}), {turns} turns".format(
                      *row["closed form"].values(), **row))  # fmt: skip
        if args.json:
            args.json.write_text(json.dumps(rows) + "\n")
    if args.plot:
        path = args.plot / "shrink_fit_cooling.png"
        plot.bodies(contact.u, 1.0 * T, path, label="temperature", scale=1.0)
    return rows


if __name__ == "__main__":
    main()
