"""A pin pulled in the hole of a plate, with friction: a curved fit, in 2D and 3D."""

import itertools

import gmsh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from sampling import longer, some_of

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.contact import load_steps
from dolfinx_llm.forms import choice

E, NU, RADIUS, PULL = 210000.0, 0.3, 10.0, 5000.0
PLATE, PIN, BORE, SHAFT, ENDS, EDGE = 1, 2, 3, 4, 5, 6


def draw(dim, h, clearance, seed, order):
    """Plate 60 x 40 (x 8) and pin in gmsh, with all tags."""
    occ, group = gmsh.model.occ, gmsh.model.addPhysicalGroup
    for option, value in ("RandomSeed", seed), ("MeshSizeMax", h), ("MeshSizeMin", h / 2):
        gmsh.option.setNumber(f"Mesh.{option}", value)
    hole = RADIUS + clearance
    if dim == 3:
        box, bore = occ.addBox(-20, -20, 0, 60, 40, 8), occ.addCylinder(0, 0, 0, 0, 0, 8, hole)
        ends = ((-4, 4), (0, 8), (8, 4))  # the part inside the bore has a face of its own
        parts = [(3, occ.addCylinder(0, 0, z, 0, 0, d, RADIUS)) for z, d in ends]
        pin, _ = occ.fragment(parts[:1], parts[1:])
    else:
        box, bore = occ.addRectangle(-20, -20, 0, 60, 40), occ.addDisk(0, 0, 0, hole, hole)
        pin = [(2, occ.addDisk(0, 0, 0, RADIUS, RADIUS))]
    plate, _ = occ.cut([(dim, box)], [(dim, bore)])
    occ.synchronize()
    tags = {BORE: [], SHAFT: [], ENDS: [], EDGE: []}
    for bodies, inner in (plate, BORE), (pin, SHAFT):
        for d, face in gmsh.model.getBoundary(bodies, oriented=False):
            centre, low = occ.getCenterOfMass(d, face), gmsh.model.getBoundingBox(d, face)
            reach = max(abs(value) for i, value in enumerate(low) if i % 3 < 2)
            if abs(centre[0] - 40.0) < 1e-6:
                tags[EDGE].append(face)
            elif reach < hole + 0.1 and (dim == 2 or abs(centre[2] - 4.0) < 1e-6):
                tags[inner].append(face)
            elif inner == SHAFT and min(abs(centre[2] + 4), abs(centre[2] - 12)) < 1e-6:
                tags[ENDS].append(face)
    group(dim, [body for _, body in plate], PLATE), group(dim, [body for _, body in pin], PIN)
    for tag, faces in tags.items():
        if faces:
            group(dim - 1, faces, tag)
    gmsh.model.mesh.generate(dim)
    gmsh.model.mesh.setOrder(order)


def pulled(dim, mu, h, clearance, seed=3, comm=MPI.COMM_WORLD, along=0.0, order=1):
    """The problem, and the load per volume (2D) or area of the pin's ends as a Constant; a part of
    it ``along`` the pin, which friction alone then holds there. Mesh and bodies of an order."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    if comm.rank == 0:
        draw(dim, h, clearance, seed, order)
    mesh, bodies, tags = compat.model_to_mesh(gmsh.model, comm, 0, gdim=dim)
    gmsh.finalize()
    V = compat.function_space(mesh, degree=order, shape=(dim,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    dx, ds = ufl.dx(subdomain_data=bodies), ufl.ds(subdomain_data=tags)
    eps = ufl.sym(ufl.grad(u))
    stress = E / (1 + NU) * (eps + NU / (1 - 2 * NU) * ufl.tr(eps) * ufl.Identity(dim))
    where = ds(ENDS) if dim == 3 else dx(PIN)
    area = fem.assemble_scalar(fem.form(fem.Constant(mesh, 1.0) * where))
    load, zero = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
    ends = range(1, 2 if along else dim) if dim == 3 else ()
    held = [(EDGE, k) for k in range(dim)] + [(ENDS, k) for k in ends]
    bcs = [
        fem.dirichletbc(
            zero, fem.locate_dofs_topological(V.sub(k), dim - 1, tags.find(tag)), V.sub(k)
        )
        for tag, k in held
    ]
    if dim == 2:  # the pin does not leave the axis
        W, _ = V.sub(1).collapse()
        at = fem.locate_dofs_geometrical(
            (V.sub(1), W), lambda x: (abs(x[1]) < 1e-6) & (abs(abs(x[0]) - RADIUS) < 1e-6)
        )
        bcs.append(fem.dirichletbc(fem.Function(W), at, V.sub(1)))
    a = ufl.inner(stress, ufl.grad(w)) * (dx(PLATE) + dx(PIN))
    contact = llm.Interface(tags, (SHAFT, BORE), law=llm.Coulomb(mu))
    L = load * (w[0] + along * w[dim - 1]) * where
    problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[contact])
    return problem, load, comm.allreduce(area)


PLANE = (2, 2.0, 0.0, 0.2), (2, 2.0, 0.02, 0.05), (2, 2.0, 0.02, 0.5)

# The pin floats until it touches, where contact without friction holds it.
SOLID = [(3, 4.0, *case) for case in
         itertools.product((0.0, 0.02, 0.05, 0.1), (0.05, 0.2, 0.5, 1.0))]  # fmt: skip

# With 0.1 contact is narrower than a facet.
FINE = [("flexibility", 3, 3.0, *case) for case in
        itertools.product((0.05, 0.1), (0.05, 0.2, 0.5, 1.0))]  # fmt: skip


@pytest.mark.parametrize(
    ("form", "dim", "h", "clearance", "mu"),
    [*some_of([("saddle", *case) for case in PLANE], [("saddle", *PLANE[2])]),
     longer("saddle", 3, 4.0, 0.02, 0.2),  # 83 where frame nodes go on at one pace
     *some_of([("flexibility", *case) for case in PLANE], [("flexibility", *PLANE[0])]),
     *some_of([("flexibility", 3, 3.0, 0.02, 0.5), *FINE], []),
     *some_of([("flexibility", *case) for case in SOLID], [("flexibility", 3, 4.0, 0.1, 1.0)])],
)  # fmt: skip
def test_converges(form, dim, h, clearance, mu, monkeypatch):
    """In a few iterations, on the load's resultant, without tension, within Coulomb's cone."""
    monkeypatch.setattr(choice, "FLEXIBLE", 0 if form == "saddle" else 10**6)
    problem, load, area = pulled(dim, mu, h, clearance)
    total = PULL if dim == 3 else PULL / 8.0
    load.value = -total / area
    problem.solve()
    assert len(problem.history) <= 25
    result = problem.results[0]
    assert result.resultant[0] == pytest.approx(-total, rel=1e-8)
    largest = max(side.normal_force.max() for side in result.sides)
    for side in result.sides:
        assert side.normal_force.min() >= -1e-10 * largest
    friction = np.linalg.norm(result.frame_friction, axis=1)
    assert (friction - mu * np.maximum(result.frame_force, 0.0)).max() <= 1e-9 * largest
    problem.destroy()


# From one load step to the next, contact and slip change at the rim of the pressed zone.
STEPS = [(2, 0.05, 0.2), *((10, *case) for case in
         [*itertools.product((0.0, 0.05), (0.05, 0.5)), (0.02, 0.2), (0.02, 1.0)])]  # fmt: skip


@pytest.mark.parametrize(("steps", "clearance", "mu"), some_of(STEPS, STEPS[:1]))
def test_converges_in_load_steps(steps, clearance, mu, monkeypatch):
    """Each in a few iterations, none of them halved; friction cancels in sum."""
    monkeypatch.setattr(load_steps, "SMALLEST", 1.0)
    problem, load, area = pulled(3, mu, 4.0, clearance)
    load.value = -PULL / area
    problem.solve(increments=steps)
    assert max(entry["iteration"] for entry in problem.history) <= 30
    result = problem.results[0]
    largest = max(side.normal_force.max() for side in result.sides)
    total = sum(side.force.sum(axis=0) for side in result.sides)
    assert np.abs(total).max() <= 1e-9 * largest
    friction = np.linalg.norm(result.frame_friction, axis=1)
    assert (friction - mu * np.maximum(result.frame_force, 0.0)).max() <= 1e-9 * largest
    problem.destroy()


@pytest.mark.long
def test_friction_alone_holds():
    """Along the pin: contact is sought without friction, in vain, and then with it."""
    problem, load, area = pulled(3, 0.5, 4.0, 0.02, along=0.02)
    load.value = -PULL / area
    problem.solve()
    assert problem.results[0].resultant[::2] == pytest.approx([-PULL, -0.02 * PULL], abs=1e-6)
    problem.destroy()


@pytest.mark.parametrize(("dim", "h", "clearance", "mu"), [
    (2, 4.0, 0.0, 0.0), longer(2, 2.0, 0.02, 0.0), (2, 2.0, 0.02, 0.5),
    longer(3, 4.0, 0.02, 0.0), longer(3, 4.0, 0.02, 0.2),
])  # fmt: skip
def test_of_second_order(dim, h, clearance, mu):
    """Contact ends on the way around: no control value of forces pulls, none of gaps is negative,
    of each pair one vanishes, and nothing is left of the load."""
    problem, load, area = pulled(dim, mu, h, clearance, order=2)
    total = PULL if dim == 3 else PULL / 8.0
    load.value = -total / area
    problem.solve()
    assert len(problem.history) <= 25
    (result,), (geometry,) = problem.results, problem.geometries
    assert result.resultant[0] == pytest.approx(-total, rel=1e-8)
    left = sum(side.force.sum(axis=0) for side in result.sides)
    assert np.abs(left).max() <= 1e-9 * total
    for pairs, side in zip(geometry.pairs, result.sides, strict=True):
        force = np.einsum("ni,ni->n", pairs.control.T @ side.force, side.normal)
        force /= np.abs(force).max()
        gap = np.linalg.solve(pairs.control.toarray(), side.frame_gap) / np.abs(side.u).max()
        assert force.min() >= -1e-8 and gap.min() >= -1e-8
        assert np.minimum(np.abs(force), np.abs(gap)).max() <= 1e-7
        assert (force > 1e-3).any() and (force <= 1e-3).any()
    problem.destroy()
