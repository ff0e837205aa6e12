"""Contact at finite deformation: exact states, objectivity, order of sides, ranks, failures."""

import finite_patch
import numpy as np
import pytest
import ufl
from conftest import run_mpi_json
from dolfinx import fem
from mpi4py import MPI
from sampling import longer
from scenes import bodies_mesh, grid

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.finite import newton
from dolfinx_llm.finite.linear import system

COMM = MPI.COMM_SELF
STRETCHES = {  # E, nu, q: lateral and vertical stretch, from the two equations by other hands
    (1000.0, 0.4, 300.0): (1.171006012193, 0.778273721944),
    (2000.0, 0.3, 300.0): (1.058438725417, 0.871978993460),
    (1000.0, 0.4, 600.0): (1.330468658018, 0.619980057299),
}
BOTTOM, LOW, HIGH, TOP, LEFT_0, LEFT_1 = 1, 2, 3, 4, 5, 6


def on(k, value):
    return lambda x: np.isclose(x[k], value)


def blocks(cells, widths=(1.0, 1.0), kind="quadrilateral", seed=5, shift=0.0):
    """Two rough blocks of height 1 and given widths, cells per block along x; their tags."""
    parts, ends, all_cells = [], [0], []
    rng = np.random.default_rng(seed)
    for k, (n, width) in enumerate(zip(cells, widths, strict=True)):
        low = (k * shift, float(k))
        x, quads = grid(n, 3, low, (low[0] + width, k + 1.0), 0.2, 7 + k)
        at = np.flatnonzero(np.isclose(x[:, 1], 1.0))
        inner = at[(x[at, 0] > low[0] + 1e-9) & (x[at, 0] < low[0] + width - 1e-9)]
        x[inner, 0] += rng.uniform(-0.25, 0.25, len(inner)) * width / n
        quads = quads + ends[-1]
        parts.append(x)
        triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        all_cells.append(quads[:, [0, 1, 3, 2]] if kind == "quadrilateral" else triangles)
        ends.append(ends[-1] + len(x))
    where = [(BOTTOM, 0, on(1, 0.0)), (LOW, 0, on(1, 1.0)), (HIGH, 1, on(1, 1.0))]
    where += [(TOP, 1, on(1, 2.0)), (LEFT_0, 0, on(0, 0.0)), (LEFT_1, 1, on(0, shift))]
    return bodies_mesh(COMM, parts, all_cells, kind, ends, where)


def bodies_of(domain, young=1000.0, poisson=0.4, degree=1):
    """Displacement and residual form."""
    V = compat.function_space(domain, degree=degree, shape=(2,))
    u = fem.Function(V)
    return V, u, finite_patch.residual(u, *finite_patch.lame(young, poisson), degree)


def pressed(cells, law=None, order=(LOW, HIGH), material=(1000.0, 0.4, 300.0), degree=1, **scene):
    """The patch test on blocks with their left sides on one line."""
    domain, tags = blocks(cells, **scene)
    V, u, F = bodies_of(domain, *material[:2], degree)
    held = []
    for k, marks in ((1, (BOTTOM,)), (0, (LEFT_0, LEFT_1))):
        facets = tags.indices[np.isin(tags.values, marks)]
        dofs = fem.locate_dofs_topological(V.sub(k), 1, facets)
        held.append(fem.dirichletbc(0.0, dofs, V.sub(k)))
    p = fem.Constant(domain, material[2])
    loads = [
        llm.FreeSurfacePressure(tags, TOP, p),
        llm.FreeSurfacePressure(tags, LOW, p, covered_by=(tags, HIGH)),
    ]
    interface = llm.Interface(tags, order, law=law or llm.Frictionless())
    return llm.NonlinearContactProblem(F, u, bcs=held, interfaces=[interface], loads=loads)


@pytest.mark.parametrize(
    "scene",
    [
        longer({"cells": (5, 16)}),
        {"cells": (9, 3), "widths": (1.0, 0.61), "kind": "triangle"},
        longer({"cells": (10, 8), "widths": (1.0, 0.73), "material": (1000.0, 0.4, 600.0)}),
        {"cells": (6, 7), "law": llm.Tied(), "material": (2000.0, 0.3, 300.0)},
        {"cells": (7, 5), "law": llm.Coulomb(0.3), "order": (HIGH, LOW)},
        longer({"cells": (5, 3), "widths": (1.0, 0.61), "kind": "triangle", "degree": 2}),
        longer({"cells": (4, 9), "law": llm.Tied(), "degree": 2}),
        {"cells": (4, 3), "law": llm.Coulomb(0.3), "widths": (1.0, 0.73), "degree": 2},
    ],
    ids=str,
)
def test_finite_patch(scene):
    """A homogeneous state stands in both bodies, in few iterations."""
    problem = pressed(**scene)
    u = problem.solve(increments=2)
    material = scene.get("material", (1000.0, 0.4, 300.0))
    x = u.function_space.tabulate_dof_coordinates()[:, :2]
    off = u.x.array.reshape(x.shape) - x * (np.array(STRETCHES[material]) - 1.0)
    assert np.abs(off).max() < 1e-10
    result, q = problem.results[0], material[2]
    pressed_on = result.frame_area > 1e-9 * result.frame_area.max()
    assert np.abs(result.pressure[pressed_on] / q - 1.0).max() < 1e-9
    assert np.abs(result.frame_friction).max() < 1e-9 * q
    assert max(h["iteration"] for h in problem.history) <= 6
    assert len({h["part"] for h in problem.history}) == 2
    forces = sum(side.force.sum(axis=0) for side in result.sides)
    moments = result.moment(side=0) + result.moment(side=1)
    assert max(np.abs(forces).max(), np.abs(moments).max()) < 1e-10 * q


def test_ties_to_a_prescribed_side():
    """All of the upper body is prescribed; its side has more nodes than the frame. Where its motion
    is homogeneous the lower body follows, where it is not it does so in the mean."""
    domain, tags = blocks((5, 9))
    V, u, F = bodies_of(domain)
    x = V.tabulate_dof_coordinates()[:, :2]
    known, g = np.array(STRETCHES[1000.0, 0.4, 300.0]), fem.Function(V)
    cells = compat.cell_dofs(V)
    upper = np.unique(cells[x[cells, 1].mean(axis=1) > 1.0]).astype(np.int32)
    bcs = [fem.dirichletbc(g, upper)]
    for k, tag in ((1, BOTTOM), (0, LEFT_0)):
        dofs = fem.locate_dofs_topological(V.sub(k), 1, tags.indices[tags.values == tag])
        bcs.append(fem.dirichletbc(0.0, dofs, V.sub(k)))
    interface = llm.Interface(tags, (LOW, HIGH), law=llm.Tied())
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])
    g.x.array[:] = (x * (known - 1.0)).ravel()
    problem.solve()
    assert np.abs(u.x.array.reshape(x.shape) - x * (known - 1.0)).max() < 1e-10
    result = problem.results[0]
    assert np.abs(result.pressure / 300.0 - 1.0).max() < 1e-9
    assert len(problem.history) <= 6
    g.x.array[1::2] -= 0.03 * x[:, 0] ** 2  # no polygon of the frame can follow
    problem.solve()
    low, high = problem.results[0].sides
    assert len(problem.history) <= 5 and np.abs(high.force).max() < 2.0 * np.abs(low.force).max()
    off = np.interp(high.x[:, 0], low.x[:, 0], low.x[:, 1]) - high.x[:, 1]
    assert 1e-5 < np.abs(off).max() < 0.03 / 25 and abs(off @ high.area) < 0.3 * abs(off).max()


@pytest.mark.parametrize(
    "laws", [(llm.Tied(), llm.Frictionless()), longer((llm.Frictionless(), llm.Frictionless()))]
)
def test_three_bodies(laws):
    """Two interfaces at once, each between meshes that do not match: the exact state."""
    parts, cells, ends = [], [], [0]
    for k, n in enumerate((5, 7, 4)):
        x, quads = grid(n, 2, (0.0, float(k)), (1.0, k + 1.0), 0.2, 11 + k)
        parts.append(x)
        cells.append(quads[:, [0, 1, 3, 2]] + ends[-1])
        ends.append(ends[-1] + len(x))
    where = [(10 * k + tag, k, on(1, float(k + tag))) for k in range(3) for tag in (0, 1)]
    where += [(10 * k + 2, k, on(0, 0.0)) for k in range(3)]
    domain, tags = bodies_mesh(COMM, parts, cells, "quadrilateral", ends, where)
    V, u, F = bodies_of(domain)
    bcs = []
    for k, marks in ((1, [0]), (0, [2, 12, 22])):
        dofs = fem.locate_dofs_topological(V.sub(k), 1, tags.indices[np.isin(tags.values, marks)])
        bcs.append(fem.dirichletbc(0.0, dofs, V.sub(k)))
    problem = llm.NonlinearContactProblem(
        F,
        u,
        bcs=bcs,
        interfaces=[
            llm.Interface(tags, (10 * k + 1, 10 * k + 10), law=law) for k, law in enumerate(laws)
        ],
        loads=[llm.FreeSurfacePressure(tags, 21, 300.0)],
    )
    problem.solve(increments=2)
    known = np.array(STRETCHES[1000.0, 0.4, 300.0])
    x = V.tabulate_dof_coordinates()[:, :2]
    assert np.abs(u.x.array.reshape(x.shape) - x * (known - 1.0)).max() < 1e-10
    for result in problem.results:
        assert np.allclose(result.resultant, [0.0, 300.0 * known[0]], rtol=0.0, atol=1e-8)
    assert max(h["iteration"] for h in problem.history) <= 6


def test_small_strains_are_those_of_the_linear_problem():
    """Rough blocks clamped at their ends: the forces differ by a part that falls with the load."""
    domain, tags = blocks((5, 7))
    V, u, F = bodies_of(domain, 1000.0, 0.3)
    trial, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    (mu, lam), eps = finite_patch.lame(1000.0, 0.3), ufl.sym(ufl.grad(trial))
    stress = 2 * mu * eps + lam * ufl.tr(eps) * ufl.Identity(2)
    g, zero = (fem.Constant(domain, (0.0, 0.0)) for _ in range(2))
    bcs = [
        fem.dirichletbc(c, fem.locate_dofs_topological(V, 1, tags.indices[tags.values == tag]), V)
        for c, tag in ((zero, BOTTOM), (g, TOP))
    ]
    interface = llm.Interface(tags, (LOW, HIGH), law=llm.Frictionless())
    a, L = ufl.inner(stress, ufl.grad(w)) * ufl.dx, ufl.inner(zero, w) * ufl.dx
    linear = llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface])
    finite = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])
    differences = []
    for down in 0.04 * 0.5 ** np.arange(4):
        g.value[1] = -down
        linear.solve()
        finite.solve()
        forces = [p.results[0].resultant[1] for p in (linear, finite)]
        differences.append(forces[1] / forces[0] - 1.0)
    slopes = np.log2(np.divide(differences[:-1], differences[1:]))
    assert differences[-1] < 3e-3 and np.abs(slopes - 1.0).max() < 0.05
    assert abs(slopes[-1] - 1.0) < 0.02


def test_fine_meshes_take_no_more_iterations():
    """A step in which nodes slide over several facets, by 0.4 times the stretch."""
    problem = pressed((49, 31), widths=(1.0, 0.5), shift=0.4)
    problem.solve()
    assert len(problem.history) <= 5
    residuals = [h["residual"] for h in problem.history[-3:]]
    assert residuals[1] < 10.0 * residuals[0] ** 2 and residuals[2] < 1e-11


def test_stretches_of_the_demo_are_known():
    for material, known in STRETCHES.items():
        young, poisson, q = material
        assert np.allclose(finite_patch.stretches(q, young, poisson), known, rtol=0, atol=1e-11)


def turned(law, angle, order=(LOW, HIGH), shift=0.05):
    """A narrow block pressed and pushed along on a wide one; all is turned from the start."""
    domain, tags = blocks((6, 8), (1.0, 0.6), shift=0.2)
    V, u, F = bodies_of(domain)
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    x = V.tabulate_dof_coordinates()[:, :2]
    u.x.array[:] = (x @ R.T - x).ravel()
    end = x + np.where(x[:, 1:] > 1.5, [shift, -0.1], 0.0)
    g = fem.Function(V)
    g.x.array[:] = (end @ R.T - x).ravel()
    facets = tags.indices[np.isin(tags.values, (BOTTOM, TOP))]
    bc = fem.dirichletbc(g, fem.locate_dofs_topological(V, 1, facets))
    interface = llm.Interface(tags, order, law=law)
    problem = llm.NonlinearContactProblem(F, u, bcs=[bc], interfaces=[interface])
    problem.solve()
    return problem, [side.force @ R for side in problem.results[0].sides]


@pytest.mark.parametrize("law", [llm.Tied(), llm.Frictionless(), llm.Coulomb(0.3)])
def test_the_analysis_serves_again(law, monkeypatch):
    """Few of the factorisations begin anew, though contact moves on. Stress is uneven: where it is
    not, rounding tells which entries vanish."""
    made = []
    real = system.DirectSolver
    monkeypatch.setattr(system, "DirectSolver", lambda *a, **k: made.append(1) or real(*a, **k))
    problem, _ = turned(law, 0.4)
    assert len(made) <= len(problem.history) // 2


@pytest.mark.parametrize(
    ("law", "degrees"),
    [longer(llm.Frictionless(), 180.0), (llm.Tied(), 90.0), (llm.Coulomb(0.2), 30.0)],
    ids=str,
)
def test_objective(law, degrees):
    """The scene turned, its sides swapped: the same forces in the turned base, the same pressure
    and normal forces."""
    problem, still = turned(law, 0.0)
    known, residuals = problem.results[0], [h["residual"] for h in problem.history]
    assert residuals[-1] < 1e-11 < residuals[-2]
    assert (known.frame_force[known.frame_status > 0] > 0.0).any()
    problem, forces = turned(law, np.deg2rad(degrees), (HIGH, LOW))
    result, size = problem.results[0], np.abs(known.pressure).max()
    for a, b in zip(still, forces[::-1], strict=True):
        assert np.abs(a - b).max() < 1e-10 * np.abs(a).max()
    for a, b in zip(known.sides, result.sides[::-1], strict=True):
        largest = np.abs(a.normal_force).max()
        assert np.abs(a.normal_force - b.normal_force).max() < 1e-9 * largest
    assert np.abs(result.pressure - known.pressure).max() < 1e-9 * size


@pytest.mark.long  # by GMRES in every run: test_finite_solvers
@pytest.mark.parametrize(
    ("n", "scene"), [(2, ["quad"]), (3, ["tet"]), (2, ["quad", "second"]), (2, ["tet", "second"])]
)
def test_ranks(n, scene):
    """One mesh of both bodies, on one rank and on several."""
    one, several = (run_mpi_json("finite_ranks.py", k, *scene) for k in (1, n))
    for found in (one, several):
        assert found["stretch"] < 1e-10 and found["pressure"] < 1e-9
    assert np.allclose(one["force"], several["force"], rtol=1e-8 if scene[1:] else 1e-9, atol=3e-7)


def test_a_step_that_fails_leaves_the_last_state(monkeypatch):
    """Blocks cannot be pressed to nothing; from where they are the way back is open."""
    monkeypatch.setattr(newton, "HALVINGS", 1)
    domain, tags = blocks((3, 4))
    V, u, F = bodies_of(domain)
    g = fem.Constant(domain, (0.0, 0.0))
    zero = fem.Constant(domain, (0.0, 0.0))
    facets = [tags.indices[tags.values == tag] for tag in (BOTTOM, TOP)]
    bcs = [
        fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, at), V)
        for value, at in zip((zero, g), facets, strict=True)
    ]
    interface = llm.Interface(tags, (LOW, HIGH), law=llm.Frictionless())
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])
    g.value[1] = -0.1
    problem.solve()
    before = problem.results[0].resultant
    g.value[1] = -2.5
    with pytest.raises(llm.ContactError, match="Newton's iteration fails at .* is kept"):
        problem.solve()
    down = -u.x.array.reshape(-1, 2)[:, 1].min()
    assert 0.1 - 1e-9 <= down < 2.0
    g.value[1] = -0.1
    with problem:  # frees the factorisation; the next solve makes it anew
        problem.solve(increments=4)
    problem.destroy()
    assert np.allclose(problem.results[0].resultant, before, rtol=1e-8, atol=1e-8 * abs(before[1]))
    with pytest.raises(llm.ContactInputError, match="side=2"):
        problem.results[0].moment(side=2)
    assert "frame on tag 2" in str(problem)


def test_elements_that_turn_inside_out_are_counted(monkeypatch):
    monkeypatch.setattr(newton, "HALVINGS", 0)
    domain, tags = blocks((3, 4))
    V, u, F = bodies_of(domain)
    interface = llm.Interface(tags, (LOW, HIGH), law=llm.Tied())
    g = fem.Constant(domain, (0.0, -1e4))
    bcs = [
        fem.dirichletbc(c, fem.locate_dofs_topological(V, 1, tags.indices[tags.values == tag]), V)
        for c, tag in ((fem.Constant(domain, (0.0, 0.0)), BOTTOM), (g, TOP))
    ]
    problem = llm.NonlinearContactProblem(F, u, bcs=bcs, interfaces=[interface])
    with pytest.raises(llm.ContactError, match=r"[1-9]\d* entries of the residual .* up to [1-9]"):
        problem.solve()
    assert not u.x.array.any()


class Unclosed(llm.Law):
    """Parts, whatever gap was drawn."""

    components, closes_gap = "normal", False


def test_refused():
    domain, tags = blocks((3, 4))
    V, u, F = bodies_of(domain)

    def make(F=F, u=u, **arguments):
        arguments.setdefault("interfaces", [llm.Interface(tags, (LOW, HIGH))])
        return llm.NonlinearContactProblem(F, u, **arguments)

    switch = llm.Coulomb(0.2, method="switch")
    for kwargs, text in [
        ({"interfaces": [llm.Interface(tags, (LOW, HIGH), law=llm.Law())]}, "ties along"),
        ({"interfaces": [llm.Interface(tags, (LOW, HIGH), law=Unclosed())]}, "as drawn counts"),
        ({"interfaces": [llm.Interface(tags, (LOW, HIGH), law=switch)]}, "method='newton'"),
        ({"interfaces": [llm.Interface(tags, (LOW, HIGH), design="positions")]}, "frame moves"),
    ]:
        with pytest.raises(llm.ContactInputError, match=text):
            make(**kwargs)
    with pytest.raises(llm.ContactInputError, match="finite number"):
        llm.FreeSurfacePressure(tags, TOP, np.nan)
    for value in (np.nan, -2.0 * V.tabulate_dof_coordinates()[:, 1]):  # nowhere, and inside out
        u.x.array[1::2] = value
        with pytest.raises(llm.ContactInputError, match=r"[1-9]\d* entries that are NaN"):
            make().solve()


def test_demo(capsys):
    found = finite_patch.main(["--cells", "tri", "--separate"])
    assert found["stretch"] < 1e-10 and found["pressure"] < 1e-9 and len(found["iterations"]) == 4
    assert "1.171006012193, 0.778273721944" in capsys.readouterr().out
