"""Two blocks that something leads at constant speed, stepped in time."""

import numpy as np
import ufl
from contact_scenes import ABOVE, BELOW, rectangle, stress
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

DT = 0.05
LEADERS = "support", "plane", "ball", "end", "force", "mean", "gap", "pressure"


class Led:
    """A block on a block, which something leads at constant speed: the support of the upper one's
    top and side, an obstacle below, a rigid end or a mean on top, a gap, a follower pressure."""

    def __init__(self, led, nonlinear=False, order=1, comm=MPI.COMM_SELF):
        self.led, self.comm = led, comm
        bodies = [rectangle(comm, (3, 5), (0, 0), (1, 1), "quadrilateral")]
        bodies += [rectangle(comm, (2, 5), (0, 1), (1, 2), "quadrilateral")]
        (low, under), (high, over) = bodies
        spaces = [compat.function_space(mesh, "Lagrange", order, (2,)) for mesh in (low, high)]
        trials = [fem.Function(V) if nonlinear else ufl.TrialFunction(V) for V in spaces]
        tests = [ufl.TestFunction(V) for V in spaces]
        pairs = list(zip(trials, tests, strict=True))
        a = [ufl.inner(stress(u), ufl.grad(w)) * ufl.dx for u, w in pairs]
        weights = [fem.Constant(mesh, (0.0, -1e-4)) for mesh in (low, high)]
        L = [ufl.inner(f, w) * ufl.dx for f, w in zip(weights, tests, strict=True)]
        given = ([one - load for one, load in zip(a, L, strict=True)], trials)
        self.moved, self.number = fem.Function(spaces[1]), fem.Constant(high, 0.0)
        law = llm.Coulomb(0.3)
        if led == "gap":
            law = llm.Tied(gap=self.number)
        interfaces = [llm.Interface(None, ((under, ABOVE), (over, BELOW)), law=law)]
        self.one = {
            "plane": llm.RigidPlane((0.0, 0.0), (0.0, 1.0)),
            "ball": llm.RigidSphere((0.4, -3.0), 3.0),
            "force": llm.RigidPlane((0.0, 2.0), (0.0, -1.0), force=(None, 0.0), moment=0.0),
            "mean": llm.MeanDisplacement((None, 0.0)),
        }.get(led, llm.RigidPlane((0.0, 2.0), (0.0, -1.0)))
        support, other = (0, lambda x: np.isclose(x[1], 0.0)), (1, lambda x: np.isclose(x[1], 2.0))
        held, options = [support, other], {}
        if led == "support":  # and a side, down to the surface that may part
            held[1] = 1, lambda x: np.isclose(x[1], 2.0) | np.isclose(x[0], 0.0)
        if led in ("plane", "ball"):
            interfaces.append(llm.Interface(under, (BELOW, self.one), law=llm.Coulomb(0.2)))
            held = [other]
        if led in ("end", "force", "mean", "pressure"):
            held = [support]
        if led in ("end", "force", "mean"):
            interfaces.append(llm.Interface(over, (ABOVE, self.one), law=llm.Tied()))
        if led == "pressure":
            options["loads"] = [llm.FreeSurfacePressure(over, ABOVE, self.number)]
        values = [fem.Function(spaces[0]), self.moved]
        bcs = [
            fem.dirichletbc(values[i], fem.locate_dofs_geometrical(spaces[i], where))
            for i, where in held
        ]
        self.times, self.s = [], llm.TimeStepper(
            1.0, *(given if nonlinear else (a, L)), dt=DT, bcs=bcs, interfaces=interfaces,
            accepted=lambda s: self.times.append(s.t), **options,
        )  # fmt: skip

    def lead(self, t):
        """To where it is at a time."""
        x, one = 1e-2 * t, self.one
        if self.led in ("support", "plane", "ball"):
            self.moved.x.array[0::2], self.moved.x.array[1::2] = x, -x
        if self.led in ("plane", "ball"):
            one.displacement, one.rotation = (0.5 * x, x), 0.3 * x
        elif self.led == "end":
            one.displacement, one.rotation = np.array([x, -x]), 0.3 * x
        elif self.led == "force":
            one.force, one.displacement, one.moment = (None, -0.1 * x), (x, 0.0), 0.03 * x
        elif self.led == "mean":
            one.mean = None, -x
        self.number.value = -x if self.led == "gap" else 20.0 * x

    def divides(self, longest):
        """Steps longer than that fail from now on."""
        once = self.s._once

        def step(dt, part):
            if dt > 1.001 * longest:
                raise llm.ContactError("too long")
            once(dt, part)

        self.s._once = step

    def found(self):
        """Values of u and v, and forces of the interfaces."""
        u, v = (np.concatenate([w.x.array for w in of]) for of in (self.s.u, self.s.v))
        return [u, v, *(r.resultant for r in self.s.problem.results)]
