"""Coulomb friction at finite deformation: a slope, what varies, bodies that come into contact."""

import finite_patch
import numpy as np
import pytest
import turned_strips
import ufl
from dolfinx import fem
from friction_block import BOTTOM, LEFT, TOP, body
from mpi4py import MPI
from sampling import longer
from scipy.integrate import simpson
from test_finite_deformation import BOTTOM as BELOW
from test_finite_deformation import HIGH, LOW, blocks, bodies_of
from test_finite_deformation import TOP as HIGHEST

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF
SLOPE, TAN = ((0.0, 0.0), (3.0, 0.5), (9, 2)), 0.1


def clamped(V, tags, tag, component=None, value=None):
    """Condition on a tagged side; on one component, or on both."""
    W = V if component is None else V.sub(component)
    facets = tags.indices[tags.values == tag]
    value = fem.Constant(V.mesh, (0.0, 0.0)) if value is None else value
    dofs = fem.locate_dofs_topological(W, 1, facets)
    return fem.dirichletbc(value, dofs, W)


class Pushed:
    """A block under its weight 1 on a slope, pushed along x by its left side."""

    def __init__(self, law, cells=(3, 2), slope=SLOPE, order=(0, 1), gap=0.0, far=0.0):
        scene = [body(COMM, *slope), body(COMM, (0.2, 0.5 + gap), (0.6, 0.6), cells)]
        Q = np.array([[1.0, -TAN], [TAN, 1.0]]) / np.hypot(1.0, TAN)
        for domain, _ in scene:
            domain.geometry.x[:, :2] = domain.geometry.x[:, :2] @ Q.T + far
        (V0, u0, F0), (V1, u1, F1) = (bodies_of(domain, 1e4, 0.3) for domain, _ in scene)
        ds = ufl.Measure("ds", domain=V1.mesh, subdomain_data=scene[1][1])
        weight = fem.Constant(V1.mesh, (0.0, 1.0 / 0.6))
        F1 = F1 + ufl.inner(weight, ufl.TestFunction(V1)) * ds(TOP)
        self.push = fem.Constant(V1.mesh, 0.0)
        bcs = [clamped(V0, scene[0][1], BOTTOM), clamped(V1, scene[1][1], LEFT, 0, self.push)]
        sides = (scene[0][1], TOP), (scene[1][1], BOTTOM)
        interface = llm.Interface(None, tuple(sides[i] for i in order), law=law)
        self.block, self.u = order.index(1), (u0, u1)
        self.problem = llm.NonlinearContactProblem(
            [F0, F1], [u0, u1], bcs=bcs, interfaces=[interface]
        )

    def to(self, x):
        """Push to x; force over weight, and the block's side."""
        self.push.value = x
        self.problem.solve()
        side = self.problem.results[0].sides[self.block]
        force = side.force.sum(axis=0)
        return -force[0] / force[1], side


def test_a_block_far_from_the_origin():
    """A million times its size: forces and places are those near it, up to the rounding of places
    as drawn. It found no convergence from a hundred thousand on."""
    found = [Pushed(llm.Coulomb(0.3), far=far) for far in (0.0, 1e6)]
    for x in (0.3, 0.5):
        (near, side), (far, there) = (pushed.to(x) for pushed in found)
        assert abs(near / far - 1.0) < 1e-7
        assert abs(near / ((TAN + 0.3) / (1.0 - 0.3 * TAN)) - 1.0) < 1e-4
        size = np.abs(side.u).max()
        assert np.abs(there.u - side.u).max() < 1e-8 * size
        assert np.abs(there.x - 1e6 - side.x).max() < 1e-8 * size
    iterations = [len(pushed.problem.history) for pushed in found]
    assert iterations[0] == iterations[1]


@pytest.mark.parametrize(
    ("mu", "cells", "slope", "step", "gap"),
    [
        longer(0.0, (3, 2), SLOPE, 0.45, 0.0),
        longer(0.1, (4, 2), SLOPE, 0.45, 0.0),
        longer(0.2, (2, 2), ((0.0, 0.0), (3.0, 0.5), (13, 2)), 0.3, 0.0),  # its frame the block's
        (0.3, (5, 3), SLOPE, 0.3, 0.01),
    ],
)
def test_block_on_a_slope(mu, cells, slope, step, gap):
    """F / G = (tan + mu) / (1 - mu tan) over lengths of the block, which may fall on it first."""
    pushed = Pushed(llm.Coulomb(mu), cells, slope, gap=gap)
    exact = (TAN + mu) / (1.0 - TAN * mu)
    for x in step * np.arange(1, 4):
        found, side = pushed.to(x)
        assert abs(found / exact - 1.0) < 1e-4
        assert set(side.status[side.status > 0]) == {2 if mu else 3}
        assert len(pushed.problem.history) <= (9 if gap else 6)
    for side in pushed.problem.results[0].sides:
        slid = np.linalg.norm(side.slip[side.status > 0], axis=1)
        assert np.abs(slid / (step * np.hypot(1.0, TAN)) - 1.0).max() < 1e-2


class Ours(llm.Coulomb):
    """A law of one's own that is asked for its rows."""

    def rows(self, nodes):
        Ours.asked = True
        return super().rows(nodes)


def test_law_derived_from_friction():
    found = Pushed(Ours(0.2)).to(0.3)[0]
    assert abs(found * (1.0 - 0.2 * TAN) / (TAN + 0.2) - 1.0) < 1e-4 and Ours.asked


def test_friction_may_vary_and_cohere():
    """A function of positions, an array, a Function of a body; a cohesion times the area."""
    x = 0.3
    known = Pushed(llm.Coulomb(0.2)).to(x)[0]
    other = fem.Function(compat.function_space(body(COMM, *SLOPE)[0]))
    for mu in (lambda p: np.full(len(p), 0.2), np.full(4, 0.2)):
        assert abs(Pushed(llm.Coulomb(mu)).to(x)[0] - known) < 1e-9
    with pytest.raises(llm.ContactInputError, match="mesh of neither side"):
        Pushed(llm.Coulomb(other))
    with pytest.raises(llm.ContactInputError, match="for each of 4 nodes"):
        Pushed(llm.Coulomb(np.full(5, 0.2)))
    # On a plane: the tangential force is mu N + c A.
    found = Pushed(llm.Coulomb(0.0, cohesion=0.5)).to(x)
    tangent = np.array([1.0, TAN]) / np.hypot(1.0, TAN)
    along = found[1].force.sum(axis=0) @ tangent
    assert abs(abs(along) / (0.5 * found[1].area.sum()) - 1.0) < 1e-3


@pytest.mark.parametrize("law", [longer(llm.Frictionless()), llm.Coulomb(0.2)], ids=str)
def test_balance_of_energy(law):
    """A block slides on a flat foundation while it is pressed: work of its top is stored energy and
    what friction takes, sum of tau·s, along a path whose rules of integration are of fourth order.
    """
    domain, tags = blocks((5, 7), (2.0, 1.0), "triangle", shift=0.3)
    V, u, F = bodies_of(domain, poisson=0.3)
    lame = (fem.Constant(domain, c) for c in finite_patch.lame(1000.0, 0.3))
    energy = fem.form(finite_patch.energy(u, *lame) * ufl.dx)
    x, cells = V.tabulate_dof_coordinates(), compat.cell_dofs(V)
    below = np.unique(cells[x[cells, 1].mean(axis=1) < 1.0]).astype(np.int32)
    zero, g = (fem.Constant(domain, (0.0, 0.0)) for _ in range(2))
    top = fem.locate_dofs_topological(V, 1, tags.indices[tags.values == HIGHEST])
    bcs = [fem.dirichletbc(zero, below, V), fem.dirichletbc(g, top, V)]
    interface = llm.Interface(tags, (LOW, HIGH), law=law)
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])

    def to(along, down):
        """Stored energy, force on the top, friction on the frame and slip of the block's nodes."""
        g.value[:] = along, -down
        problem.solve()
        side = problem.results[0].sides[1]
        tau = side.force - side.normal_force[:, None] * side.normal
        reaction = compat.assemble_force((fem.form(F),), (1.0,), V).reshape(-1, 2)
        return fem.assemble_scalar(energy), reaction[top].sum(axis=0), tau, side.slip

    to(0.0, 0.05)
    way = np.linspace(0.1, 0.2, 5)  # two pairs of steps
    stored, force, tau, slip = zip(*(to(s, 0.05 + 0.5 * (s - 0.1)) for s in way), strict=True)
    work = simpson(np.array(force) @ [1.0, -0.5], x=way)
    lost = 0.0
    for k in (0, 2):  # speeds of a motion that is quadratic over a pair of steps
        first, second = slip[k + 1], slip[k + 2]
        speeds = (3 * first - second) / 2, (first + second) / 2, (3 * second - first) / 2
        lost += sum(w / 3 * (t * v).sum() for w, t, v in zip((1, 4, 1), tau[k:], speeds))
    assert abs(stored[-1] - stored[0] + lost - work) < 1e-6 * work
    assert lost > 0.1 * work if law.slips else lost == 0.0


@pytest.mark.long
def test_energy_comes_back_as_meshes_get_finer():
    """Both bodies give way along a curved surface, without friction: forces along averaged normals
    are no gradient, so that work misses the stored energy, by less on finer meshes."""
    missed = []
    for n, steps in ((1, 8), (2, 8), (4, 16)):
        domain, tags = blocks((5 * n, 7 * n), (2.0, 1.0), "triangle", shift=0.3)
        x = domain.geometry.x
        wave = 0.1 * np.cos(np.pi * (x[:, 0] - 0.8))
        x[:, 1] += wave * np.clip(np.minimum(x[:, 1], 2.0 - x[:, 1]), 0.0, None)
        V, u, F = bodies_of(domain, poisson=0.3)
        lame = (fem.Constant(domain, c) for c in finite_patch.lame(1000.0, 0.3))
        energy = fem.form(finite_patch.energy(u, *lame) * ufl.dx)
        zero, g = (fem.Constant(domain, (0.0, 0.0)) for _ in range(2))
        bcs = [clamped(V, tags, tag, value=value) for tag, value in ((BELOW, zero), (HIGHEST, g))]
        top = fem.locate_dofs_topological(V, 1, tags.indices[tags.values == HIGHEST])
        interface = llm.Interface(tags, (LOW, HIGH), law=llm.Frictionless())
        problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])
        way, stored, force = np.linspace(0.1, 0.2, steps + 1), [], []
        for along in (0.0, *way):
            g.value[:] = along, -0.05 - max(0.5 * (along - 0.1), 0.0)
            problem.solve()
            reaction = compat.assemble_force((fem.form(F),), (1.0,), V).reshape(-1, 2)
            stored.append(fem.assemble_scalar(energy))
            force.append(reaction[top].sum(axis=0))
        work = simpson(np.array(force[1:]) @ [1.0, -0.5], x=way)
        missed.append(abs((stored[-1] - stored[1]) / work - 1.0))
    assert missed[0] < 2e-2 and missed[1] < missed[0] / 4 and missed[2] < missed[1] / 2, missed


def test_slip_converges_as_fast_as_contact():
    """Strips that slip are pressed, pushed along, and turned by 10 degrees on the way back: where
    all pairs stand Newton's iteration is quadratic, down to rounding of forces that just reach
    their bounds. Then all turns by 120 degrees at once, of which it sees nothing."""
    strips = turned_strips.Strips(llm.Coulomb(0.1), COMM)
    for shift, angle in ((0.0, 0.0), (turned_strips.SHIFT, 0.0), (0.02, np.pi / 18)):
        strips.step(shift, angle)
        history = strips.problem.history
        assert strips.counts()[1] > 0 or angle  # pairs at the bound may stick when all is turned
        near = [h["residual"] for h in history if h["residual"] < 0.01]
        assert len(near) <= 4 and near[1] < 100.0 * near[0] ** 2
    force, _ = strips.step(0.02, np.pi / 18)
    there, slip = strips.step(0.02, 13 * np.pi / 18)
    assert np.abs(there - force).max() < 1e-10 * np.abs(force).max() and slip < 1e-14
    assert len(strips.problem.history) == 1


@pytest.mark.parametrize("mu", [0.1, longer(0.3)])
def test_few_iterations_in_compression(mu):
    """Steps of 10 %, the ends of rough blocks being held."""
    domain, tags = blocks((6, 8), (1.0, 0.6), shift=0.2)
    V, u, F = bodies_of(domain)
    g, zero = (fem.Constant(domain, (0.0, 0.0)) for _ in range(2))
    bcs = [clamped(V, tags, tag, value=value) for tag, value in ((BELOW, zero), (HIGHEST, g))]
    interface = llm.Interface(tags, (LOW, HIGH), law=llm.Coulomb(mu))
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])
    for down in (0.2, 0.4, 0.6):
        g.value[1] = -down
        problem.solve()
        residuals = [h["residual"] for h in problem.history]
        assert len(residuals) <= 7 and residuals[-2] < 1e-4
