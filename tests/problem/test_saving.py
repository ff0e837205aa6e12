"""States saved and read again: the next step is the one that would have been."""

from dataclasses import fields

import mixed
import numpy as np
import pytest
import ufl
from conftest import run_mpi_json
from dolfinx import fem, mesh
from friction_block import Dragged
from mixed_saved import WAYS, Block
from mpi4py import MPI
from sampling import longer
from saved import figures
from submeshes import Halves

import dolfinx_llm as llm
from dolfinx_llm import compat

DRAGS = 0.0, 0.001, 0.0016


def test_friction_goes_on_on_two_ranks(tmp_path):
    """Slip of the steps before counts: forces, slip, gaps and displacement, as without a stop."""
    scene = Dragged(0.3, (6, 9))
    for drag in DRAGS:
        scene.step(drag)
    file = tmp_path / "state.npz"
    scene.problem.save(file)
    saved = figures(scene.problem)
    scene.step(0.002)
    exact = figures(scene.problem)
    scene.problem.load(file)  # back to where it was
    for a, b in zip(figures(scene.problem), saved, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12 * np.abs(b).max())
    found = run_mpi_json("saved.py", 2, file, 0.002)
    for a, b in zip(found["figures"], exact, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12 * np.abs(b).max())


def test_impact_goes_on(tmp_path):
    """In the middle of contact, by another stepper."""
    import impact_bar

    first, second = (impact_bar.Bar(10, comm=MPI.COMM_SELF) for _ in range(2))
    first.run(1.4)
    first.stepper.save(tmp_path / "bar.npz")
    second.stepper.load(tmp_path / "bar.npz")
    assert second.stepper.t == first.stepper.t
    ends = [bar.run(2.2)[-1] for bar in (first, second)]
    np.testing.assert_allclose(*ends, atol=1e-13)
    np.testing.assert_allclose(first.stepper.v.x.array, second.stepper.v.x.array, atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("ranks", [2, 3])
def test_impact_goes_on_on_ranks(ranks, tmp_path):
    """Saved in the middle of contact; time, pressure, energies and momentum after it."""
    import impact_bar

    bar = impact_bar.Bar(10, comm=MPI.COMM_SELF)
    bar.run(1.4)
    bar.stepper.save(tmp_path / "bar.npz")
    exact = bar.run(2.2)[-1]
    found = run_mpi_json("saved_steps.py", ranks, tmp_path / "bar.npz", 2.2)["last"]
    np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-12)


def pressed(n=3, law=None):
    """A residual form of a block on a plane."""
    corners = [[0.0, 0.0], [1.0, 1.0]]
    domain = mesh.create_rectangle(MPI.COMM_SELF, corners, [n, n])
    V = compat.function_space(domain, shape=(2,))
    u, w = fem.Function(V), ufl.TestFunction(V)
    at = [mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
          for y in (0.0, 1.0)]  # fmt: skip
    tags = mesh.meshtags(domain, 1, np.sort(at[0]), np.full(len(at[0]), 1, dtype=np.int32))
    top = fem.Constant(domain, (0.0, -0.02))
    bc = fem.dirichletbc(top, fem.locate_dofs_topological(V, 1, at[1]), V)
    F = ufl.inner(ufl.grad(u) + ufl.grad(u) * ufl.tr(ufl.grad(u)), ufl.grad(w)) * ufl.dx
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    interface = llm.Interface(tags, (1, plane), law=law or llm.Coulomb(0.3))
    return llm.NonlinearContactProblem(F, u, bcs=[bc], interfaces=[interface]), top


@pytest.mark.parametrize("law", [llm.Coulomb(0.3), longer(llm.Tied())], ids=str)
def test_results_at_finite_deformation(law, tmp_path):
    """After ``load`` they are those of the step that was saved, with a frame and without one."""
    from turned_strips import Strips

    strips, (other, _), (block, _) = Strips(law, MPI.COMM_SELF), pressed(), pressed()
    for _ in range(2):
        strips.step(0.03)
    block.solve()
    for problem, new in ((strips.problem, Strips(law, MPI.COMM_SELF).problem), (block, other)):
        problem.save(tmp_path / "state.npz")
        new.load(tmp_path / "state.npz")
        (known,), (found,) = problem.results, new.results
        parts = [(known, found), *zip(known.sides, found.sides, strict=True)]
        parts += [(known.frame, found.frame)] * (known.frame is not None)
        assert len(parts) == (4 if known.frame else 2) and type(found) is type(known)
        for one, two in parts:
            for f in fields(one):
                a, b = getattr(one, f.name), getattr(two, f.name)
                assert isinstance(a, (np.ndarray, float)) == isinstance(b, (np.ndarray, float))
                if isinstance(a, (np.ndarray, float)):
                    np.testing.assert_array_equal(a, b)
        assert (known.resultant == found.resultant).all() and np.abs(found.pressure).max() > 0.0


@pytest.mark.long
def test_finite_deformation_goes_on(tmp_path):
    found = []
    for name in (None, "state.npz"):
        problem, top = pressed()
        if name is None:
            problem.solve()
            top.value[0] = 0.01
            problem.solve()
            problem.save(tmp_path / "state.npz")
        else:
            problem.load(tmp_path / name)
        top.value[:] = 0.004, -0.03
        problem.solve()
        found.append(problem.u.x.array.copy())
    np.testing.assert_allclose(*found, atol=1e-13)


@pytest.mark.parametrize("nonlinear", [False, True])
def test_bodies_on_submeshes(nonlinear, tmp_path):
    """Cells of a submesh have no numbers of their own from a file: those of their nodes serve."""
    first, second = (Halves("own", nonlinear) for _ in range(2))
    problem, other = first.problem(), second.problem()
    u = problem.solve()
    problem.save(tmp_path / "state.npz")
    other.load(tmp_path / "state.npz")
    for a, b in zip(u, second.u if nonlinear else other.u, strict=True):
        np.testing.assert_array_equal(a.x.array, b.x.array)
    assert np.abs(u[0].x.array).max() > 1e-3


@pytest.mark.parametrize("kind", ["linear", pytest.param("nonlinear", marks=pytest.mark.long)])
def test_mixed_spaces_go_on_on_two_ranks(kind, tmp_path):
    """Pressures as well; friction remembers which way the block was dragged."""
    block = Block(kind, MPI.COMM_SELF)
    for way in WAYS[:-1]:
        block.drag(way)
    saved, file = block.figures(), tmp_path / "state.npz"
    block.problem.save(file)
    exact = block.drag(WAYS[-1])
    assert np.abs(exact[0] - saved[0]).max() > 0.1 * np.abs(exact[0]).max()
    found = run_mpi_json("mixed_saved.py", 2, file, kind)["figures"]
    for a, b in zip(found, exact, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(b).max())
    other = Block(kind, MPI.COMM_SELF)
    other.problem.load(file)
    for a, b in zip(other.figures(), saved, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12 * np.abs(b).max())


def test_blocks_whose_order_depends_on_ranks(tmp_path):
    """Of third order there are two dofs at an edge, in the order of the mesh's numbers."""
    blocks = ("Lagrange", 3, False), ("Lagrange", 2, True)
    with mixed.pressed(llm.Tied(), blocks, MPI.COMM_SELF) as problem:
        problem.solve()
        with pytest.raises(llm.ContactInputError, match="third order"):
            problem.save(tmp_path / "state.npz")


def test_laws_and_problems_of_other_kinds(tmp_path):
    """At the same places: what laws keep, and steps in time have, is missing."""
    import impact_bar

    first, bar = pressed()[0], impact_bar.Bar(6, comm=MPI.COMM_SELF)
    first.solve()
    first.save(tmp_path / "law.npz")
    bar.stepper.problem.save(tmp_path / "kind.npz")
    others = pressed(law=llm.Frictionless())[0], bar.stepper
    for other, name in zip(others, ("law", "kind"), strict=True):
        with pytest.raises(llm.ContactInputError, match="another scene: it has .*, and this one"):
            other.load(tmp_path / f"{name}.npz")


def test_errors(tmp_path):
    """Nothing solved, no file, another file, another scene; an old file stays where it fails."""
    problem, _ = pressed()
    scene = Dragged(0.3, (4, 5))
    with pytest.raises(llm.ContactError, match="call solve"):
        scene.problem.save(tmp_path / "a.npz")
    scene.step(0.0)
    with pytest.raises(llm.ContactInputError, match="must end on .npz"):
        scene.problem.save(tmp_path / "a.txt")
    scene.problem.save(tmp_path / "a.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["a.npz"]
    for other in (Dragged(0.3, (5, 5)).problem, problem):
        with pytest.raises(llm.ContactInputError, match="of another scene"):
            other.load(tmp_path / "a.npz")
    (tmp_path / "b.npz").write_bytes(b"PK")
    np.savez(tmp_path / "c.npz", x=1.0)
    for name in ("b.npz", "c.npz", "no.npz"):
        with pytest.raises(llm.ContactInputError, match=r"save\(\) wrote"):
            problem.load(tmp_path / name)
