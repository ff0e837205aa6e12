"""Two quarter balls of tetrahedra, pressed on each other: beside contact, forces of corrected rows
die out from frame node to frame node, and which of these touch is found at once."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

A = 0.12  # radius of contact, of the balls' [length]
MATERIALS = (1000.0, 0.3), (2000.0, 0.25)


def ball(up, size):
    """A quarter of a half ball of radius 1 that touches the origin, from above or below, graded;
    facets 1 round, 2 flat, 3 and 4 the planes of symmetry."""
    import gmsh

    sign = 1 if up else -1
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add("ball")
    around = (-np.pi / 2, 0.0) if up else (0.0, np.pi / 2)
    volume = gmsh.model.occ.addSphere(0, 0, sign, 1, -1, *around, np.pi / 2)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [volume], 1)
    groups = {1: [], 2: [], 3: [], 4: []}
    for _, tag in gmsh.model.getEntities(2):
        centre = np.array(gmsh.model.occ.getCenterOfMass(2, tag)) - [0, 0, sign]
        flat = gmsh.model.getType(2, tag) == "Plane"
        groups[{0: 3, 1: 4, 2: 2}[int(np.argmin(np.abs(centre)))] if flat else 1].append(tag)
    for number, tags in groups.items():
        gmsh.model.addPhysicalGroup(2, tags, number)
    field = gmsh.model.mesh.field
    field.add("MathEval", 1)
    beyond = f"sqrt(x*x+y*y+z*z)-{1.4 * A}"
    field.setString(1, "F", f"{size}+0.095*({beyond}+abs({beyond}))")
    field.setAsBackgroundMesh(1)
    for name in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        gmsh.option.setNumber(f"Mesh.MeshSize{name}", 0)
    gmsh.model.mesh.generate(3)
    mesh, _, tags = compat.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=3)
    gmsh.finalize()
    return mesh, tags


def balls(n, solver, law, **options):
    """The problem, and what presses the upper ball."""
    forms, loads, bcs, sides = [], [], [], []
    for up, ((E, nu), cells) in enumerate(zip(MATERIALS, n, strict=True)):
        mesh, tags = ball(bool(up), A / cells)
        V = compat.function_space(mesh, degree=1, shape=(3,))
        u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
        strain = ufl.sym(ufl.grad(u))
        stress = E / (1 + nu) * (strain + nu / (1 - 2 * nu) * ufl.tr(strain) * ufl.Identity(3))
        forms.append(ufl.inner(stress, ufl.grad(v)) * ufl.dx)
        loads.append(ufl.inner(fem.Constant(mesh, np.zeros(3)), v) * ufl.dx)
        moved = fem.Function(V)
        bcs.append(fem.dirichletbc(moved, fem.locate_dofs_topological(V, 2, tags.find(2))))
        for k in (0, 1):
            W = V.sub(k)
            dofs = fem.locate_dofs_topological(W, 2, tags.find(3 + k))
            bcs.append(fem.dirichletbc(0.0, dofs, W))
        sides.append((tags, 1))
    interface = llm.Interface(None, tuple(sides), law=law)
    problem = llm.ContactProblem(
        forms, loads, bcs=bcs, interfaces=[interface], solver=solver, **options
    )
    return problem, moved


@pytest.mark.parametrize("n", [(3, 4.5), pytest.param((8, 12), marks=pytest.mark.long)])
def test_iterations(n):
    """With 8 and 12 facets the condensed form took 29 iterations, and did not come to rest in the
    second step; with 3 and 4.5 it ended in an error. Forces of corrected rows that die out beside
    contact are no more than 1e-5 of the largest where forms differ by more than 1e-8 of it."""
    found, forces = {}, {}
    for solver in ("saddle", "condensed", "auto"):
        problem, moved = balls(n, solver, llm.Frictionless())
        for down in (0.0288, 0.026):
            moved.x.array[2::3] = -down
            problem.solve()
            found.setdefault(solver, []).append(len(problem.history))
            sides = problem.results[0].sides
            forces.setdefault(solver, []).append(np.concatenate([s.normal_force for s in sides]))
        form = problem.form
        problem.destroy()
    assert form == "flexibility"
    assert max(found["saddle"] + found["auto"]) <= 10 and max(found["condensed"]) <= 30
    for one, other in zip(forces["saddle"], forces["condensed"], strict=True):
        most, beside = one.max(), one < 2e-5 * one.max()
        assert min(one.min(), other.min()) >= -1e-9 * most
        assert np.abs(one - other)[~beside].max() <= 5e-7 * most
        assert np.abs(one - other).max() <= 2e-6 * most


def test_friction_across_planes_of_symmetry():
    """Frame nodes at planes of symmetry, where contact has parted at what else holds them, went 300
    across these, and on in each iteration; the condensed form ended in an error. It took up to 140
    iterations while frames were let go as they were, to another state; and factorised it left gaps
    of pairs that close, differences of large motions of the frame."""
    forces = {}
    factorised = {"petsc_options": {"pc_type": "lu"}}
    for solver, most, options in (
        ("saddle", 30, {}), ("condensed", 45, {}), ("condensed", 45, factorised)
    ):  # fmt: skip
        problem, moved = balls((3, 4.5), solver, llm.Coulomb(0.2), **options)
        for down in (0.0288, 0.026):
            moved.x.array[2::3] = -down
            problem.solve()
            result = problem.results[0]
            assert len(problem.history) <= most
            assert np.abs(result.frame.v[:, :2]).max() <= 1e3 * down  # along the surface
            friction = np.linalg.norm(result.frame_friction, axis=1)
            most_pressed = result.frame_force.max()
            assert (friction - 0.2 * result.frame_force).max() <= 1e-6 * most_pressed
            push = sum(s.force.sum(axis=0) for s in result.sides)
            assert np.abs(push).max() <= 1e-8 * result.sides[0].force.sum(axis=0)[2]
            whole = np.concatenate([u.x.array for u in problem.u])
            R, first = problem.bulk.force(whole).reshape(-1, 3), len(problem.u[0].x.array) // 3
            pairs = problem.geometries[0].pairs  # in K u - f: the mean plane leans by 3e-5
            presses = [R[k * first + p.dofs, 2].sum() for k, p in enumerate(pairs)]
            assert abs(sum(presses)) <= 1e-8 * presses[0]
            sides = np.concatenate([s.normal_force for s in result.sides])
            forces.setdefault(down, []).append(sides)
        problem.destroy()
    # Which nodes at the rim slip as others do follows from pairs that hardly press: forms differ by
    # up to 2e-7, with the mesh of gmsh 4.15 by 7e-5.
    for one, *others in forces.values():
        assert min(f.min() for f in (one, *others)) >= -1e-9 * one.max()
        assert max(np.abs(one - f).max() for f in others) <= 1e-4 * one.max()
