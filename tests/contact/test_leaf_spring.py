"""Layers that are pressed together and bent to and fro slip on each other, and back."""

import numpy as np
import pytest
import scenes
import ufl
from dolfinx import fem
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

LENGTH, MU, PRESSED = 20.0, 0.3, 1.0


class Spring:
    """Layers of height 1, clamped at x = 0, sheared at the other end by ``force``, in units of that
    at which the joint in the middle would slip all along."""

    def __init__(self, cells, solver="auto"):
        count = len(cells)
        made = [scenes.grid(n, 2, (0.0, k), (LENGTH, k + 1.0)) for k, n in enumerate(cells)]
        ends = np.cumsum([0, *(len(x) for x, _ in made)])
        quads = [q[:, [0, 1, 3, 2]] + first for (_, q), first in zip(made, ends)]
        where = [(2 * k + i, k, scenes.on(1, k + i - 1.0)) for k in range(count) for i in (1, 2)]
        where += [(20 + k, k, scenes.on(0, LENGTH)) for k in range(count)]
        args = [x for x, _ in made], quads, "quadrilateral", ends, where
        domain, tags = scenes.bodies_mesh(MPI.COMM_SELF, *args)
        V = compat.function_space(domain, shape=(2,))
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        ds = ufl.ds(domain, subdomain_data=tags)
        self.pull, self.slips = fem.Constant(domain, 0.0), 2.0 / 3.0 * MU * PRESSED
        pressed = PRESSED * w[1] * ds(1) - PRESSED * w[1] * ds(2 * count)
        sheared = sum(self.pull * w[1] * ds(20 + k) for k in range(count))
        sigma = 1e4 * ufl.sym(ufl.grad(u))
        self.problem = llm.ContactProblem(
            ufl.inner(sigma, ufl.sym(ufl.grad(w))) * ufl.dx,
            pressed + sheared,
            bcs=scenes.hold(V, [(0, scenes.on(0, 0.0)), (1, scenes.on(0, 0.0))]),
            interfaces=[
                llm.Interface(tags, (2 * k, 2 * k + 1), law=llm.Coulomb(MU))
                for k in range(1, count)
            ],
            solver=solver,
        )

    def go(self, force):
        """Iterations of a load step."""
        self.pull.value = force * self.slips
        self.problem.solve()
        return self.problem.history[-1]["iteration"]


@pytest.mark.parametrize(
    ("cells", "solver"),
    [((20, 27, 23), "auto"), longer((20, 27, 23), "condensed"), longer((20, 27), "auto")]
    + [longer((24, 20, 24), "auto"), longer((20, 24, 20, 24), "auto")],
)
def test_bent_to_and_fro(cells, solver):
    """A node between two that slip against each other was spoken for by either in turns, as a pair
    opened and closed by turns: "did not converge in 100 iterations", however small the step."""
    spring, found = Spring(cells, solver), []
    for force in (0.0, 1.0, 2.0, 1.0, 0.0, -1.0, -2.0, -1.0, 0.0, 1.0):
        assert spring.go(force) < 40
        found.append(spring.problem.results[0].sides[0].force.sum(axis=0))
    size = PRESSED * LENGTH
    np.testing.assert_allclose([f[1] for f in found], found[0][1], rtol=0.0, atol=0.2 * size)
    for result in spring.problem.results:
        friction = np.linalg.norm(result.frame_friction, axis=1).sum()
        assert friction <= MU * np.abs(result.resultant[1]) * 1.01
    spring.problem.destroy()
