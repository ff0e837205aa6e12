"""Blocks on each other in 2D, with springs, moduli and laws of their own."""

import contact_scenes as scenes
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF


class Stack:
    """Rectangles of height 1, the lowest from x = -1 to 1, one on the other.

    Args:
        laws: of the interfaces, from below.
        moduli: E of each block over that of ``scenes.stress``.
        springs: of each block, per volume [of its E].
        loads: of each block, per volume, (2,) each.
        held: blocks whose lower edge is fixed.
        solver, limit: of the problem; ``FLEXIBLE`` is patched by the caller.
    """

    def __init__(
        self, laws, *, moduli=None, springs=None, loads=None, held=(0,), comm=COMM, turn=0.0,
        tops=(), **options,
    ):  # fmt: skip
        count = len(laws) + 1
        moduli, springs = moduli or [1.0] * count, springs or [0.0] * count
        rng = np.random.default_rng(11)
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        self.R, self.blocks = R, []
        for k in range(count):
            half = 1.0 - 0.15 * k
            self.blocks.append(
                scenes.rectangle(
                    comm, (5 + 2 * ((k + 1) % 2), 3), (-half, k), (half, k + 1.0),
                    "quadrilateral" if k % 2 else "triangle", 0.2, rng,
                )
            )  # fmt: skip
        self.drawn = []
        for domain, _ in self.blocks:
            self.drawn.append(domain.geometry.x.copy())
            domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ R.T
        self.spaces = [compat.function_space(d, shape=(2,)) for d, _ in self.blocks]
        forms_a, forms_L, self.loads, bcs = [], [], [], []
        for k, V in enumerate(self.spaces):
            u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
            E, s = (fem.Constant(V.mesh, float(v)) for v in (moduli[k], springs[k] * scenes.E))
            load = fem.Constant(V.mesh, np.zeros(2))
            a = E * ufl.inner(scenes.stress(u), ufl.grad(w)) * ufl.dx
            forms_a.append(a + E * s * ufl.inner(u, w) * ufl.dx)
            forms_L.append(ufl.inner(load, w) * ufl.dx)
            self.loads.append(load)
            if k in held:
                bcs += self._hold(V, k)
        self.load(loads or [(0.0, 0.0)] * count)
        self.tops = {}
        for k in tops:
            motion = fem.Function(self.spaces[k])
            dofs = fem.locate_dofs_geometrical(
                self.spaces[k], lambda p, k=k: np.isclose((R.T @ p[:2])[1], k + 1.0)
            )
            bcs.append(fem.dirichletbc(motion, dofs))
            self.tops[k] = motion
        tags = [t for _, t in self.blocks]
        interfaces = [
            llm.Interface(None, ((tags[k], scenes.ABOVE), (tags[k + 1], scenes.BELOW)), law=law)
            for k, law in enumerate(laws)
        ]
        self.problem = llm.ContactProblem(
            forms_a, forms_L, bcs=bcs, interfaces=interfaces, **options
        )

    def _hold(self, V, k):
        R = self.R
        return scenes.hold_all(
            V, lambda p: np.isclose((R.T @ p[:2])[1], float(k)), lambda p: 0.0 * p
        )

    def load(self, loads):
        """Forces per volume (2,) of each block, in the drawn base."""
        for constant, value in zip(self.loads, loads, strict=True):
            constant.value[:] = self.R @ np.asarray(value, dtype=float)

    def solve(self, **options):
        return self.problem.solve(**options)
