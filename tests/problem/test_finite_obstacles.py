"""Rigid obstacles at finite deformation: exact states, motions, obstacles of one's own."""

import finite_patch
import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.finite import obstacle_contact
from dolfinx_llm.geometry.surface import Surface

COMM = MPI.COMM_SELF
FOOT, TOP = 1, 2
KINDS = {"quad": (2, mesh.CellType.quadrilateral), "tet": (3, mesh.CellType.tetrahedron)}


class Floor(llm.Obstacle):
    """The plane y = 0 in 2D, by a rough estimate of the distance: right where it is 0."""

    def clearance(self, x):
        into = np.zeros_like(x)
        into[:, -1] = -1.0
        return x[:, -1] * (1.0 + 0.3 * x[:, -1]), into


def block(kind, cells=4):
    """Unit block, its foot and top tagged; displacement and residual."""
    dim, cell = KINDS[kind]
    make = mesh.create_rectangle if dim == 2 else mesh.create_box
    domain = make(COMM, [np.zeros(dim), np.ones(dim)], [cells, *(3,) * (dim - 1)], cell)
    at = [
        mesh.locate_entities_boundary(domain, dim - 1, lambda p, y=y: np.isclose(p[dim - 1], y))
        for y in (0.0, 1.0)
    ]
    order = np.argsort(np.concatenate(at))
    values = np.repeat([FOOT, TOP], [len(found) for found in at]).astype(np.int32)
    tags = mesh.meshtags(domain, dim - 1, np.concatenate(at)[order], values[order])
    V = compat.function_space(domain, shape=(dim,))
    u = fem.Function(V)
    mu, lam = (fem.Constant(domain, c) for c in finite_patch.lame(1000.0, 0.4))
    energy = finite_patch.energy(u, mu, lam) if dim == 2 else energy_3d(u, mu, lam)
    return domain, tags, V, u, ufl.derivative(energy * ufl.dx, u, ufl.TestFunction(V))


def energy_3d(u, mu, lam):
    F = ufl.Identity(3) + ufl.grad(u)
    J = ufl.det(F)
    return mu / 2 * (ufl.inner(F, F) - 3) - mu * ufl.ln(J) + lam / 2 * ufl.ln(J) ** 2


def rolled(V, axes):
    """Conditions that hold the faces x_k = 0."""
    bcs = []
    for k in axes:
        Vk, _ = V.sub(k).collapse()
        dofs = fem.locate_dofs_geometrical((V.sub(k), Vk), lambda p, k=k: np.isclose(p[k], 0.0))
        bcs.append(fem.dirichletbc(fem.Function(Vk), dofs, V.sub(k)))
    return bcs


@pytest.mark.parametrize("obstacle", ["plane", "own"])
def test_patch(obstacle):
    """A block pressed on a plane by a follower pressure: homogeneous, in few iterations."""
    _, tags, V, u, F = block("quad")
    floor = llm.RigidPlane((0.0, 0.0), (0.0, 1.0)) if obstacle == "plane" else Floor()
    problem = llm.NonlinearContactProblem(
        F,
        u,
        bcs=rolled(V, (0,)),
        interfaces=[llm.Interface(tags, (FOOT, floor), law=llm.Frictionless())],
        loads=[llm.FreeSurfacePressure(tags, TOP, 300.0)],
    )
    problem.solve(increments=2)
    x = V.tabulate_dof_coordinates()[:, :2]
    known = np.array([1.171006012193, 0.778273721944]) - 1.0
    assert np.abs(u.x.array.reshape(x.shape) - x * known).max() < 1e-10
    result = problem.results[0]
    assert result.frame is None and len(result.sides) == 1 and "no frame" in str(problem)
    assert np.abs(result.pressure / 300.0 - 1.0).max() < 1e-9
    assert np.allclose(result.resultant, [0.0, -300.0 * 1.171006012193], atol=1e-7)
    assert max(h["iteration"] for h in problem.history) <= 5


def test_moved_and_turned_in_3d():
    """A plane that comes from afar, presses and turns by 90° with the block's top: the same forces
    in the turned base as without turning."""
    found = []
    for degrees in (0.0, 90.0):
        domain, tags, V, u, F = block("tet", 3)
        R = obstacle_contact.Rotation.from_rotvec([np.deg2rad(degrees), 0.0, 0.0]).as_matrix()
        plane = llm.RigidPlane((0.0, 0.0, -0.2), (0.0, 0.0, 1.0), pivot=(0.5, 0.5, 1.0))
        g = fem.Function(V)
        top = fem.locate_dofs_topological(V, 2, tags.indices[tags.values == TOP])
        problem = llm.NonlinearContactProblem(
            F,
            u,
            bcs=[fem.dirichletbc(g, top)],
            interfaces=[llm.Interface(tags, (FOOT, plane), law=llm.Frictionless())],
        )
        plane.displacement = (0.0, 0.0, 0.3)
        problem.solve()
        x = V.tabulate_dof_coordinates()
        g.x.array[:] = ((x - [0.5, 0.5, 1.0]) @ (R.T - np.eye(3))).ravel()
        plane.rotation = (np.deg2rad(degrees), 0.0, 0.0)
        plane.displacement = R @ (0.0, 0.0, 0.3)
        problem.solve(increments=3)
        found.append(problem.results[0].sides[0].force @ R)
    assert found[0][:, 2].max() < -1.0
    assert np.abs(found[0] - found[1]).max() < 1e-9 * np.abs(found[0]).max()


@pytest.mark.parametrize("gdim", [2, 3])
def test_tangent_is_the_derivative(gdim, monkeypatch):
    """Differences of the clearance against those of force and gap, on a turned sphere."""
    monkeypatch.setattr(obstacle_contact, "TURNED_AWAY", -2.0)  # all nodes take part
    rng = np.random.default_rng(5)
    x = rng.uniform(-0.4, 0.4, (6, gdim))
    x[:, -1] = -1.0 + 0.01 * x[:, 0]
    facets = np.arange(6).reshape(-1, gdim)[:, ::-1]
    surface = Surface(x, facets, np.arange(6), np.zeros(6, dtype=int), "patch")
    ball = llm.RigidSphere(np.eye(gdim)[-1] * -3.0, 2.0, rotation=0.3 if gdim == 2 else (0.3, 0, 0))
    contact = obstacle_contact.ObstacleContact.of(surface, ball)
    held, q = contact.hold(x.ravel()), rng.uniform(0.5, 1.5, 6)
    on, free = np.full(6, 3), np.ones(x.size, dtype=bool)

    def terms(z):
        return contact.terms(contact.place(z, held), q, on, held, free)

    t, h = terms(x.ravel()), 1e-6
    for e in np.eye(x.size):
        a, b = (terms(x.ravel() + s * h * e) for s in (1.0, -1.0))
        assert np.abs(t.K @ e + (a.force - b.force) / (2 * h)).max() < 1e-8
        assert np.abs(t.left @ e - (a.rest - b.rest) / (2 * h)).max() < 1e-8


def test_refused():
    domain, tags, V, u, F = block("quad")
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    for law, floor, text in [
        (llm.Coulomb(0.2), plane, "choose Frictionless"),
        (llm.Frictionless(), llm.RigidPlane((0, 0, 0), (0, 0, 1)), "lies in 3D"),
        (llm.Frictionless(), llm.RigidPlane((0, 0), (0, 1), force=(None, -1.0)), "displacement"),
    ]:
        interface = llm.Interface(tags, (FOOT, floor), law=law)
        with pytest.raises(llm.ContactInputError, match=text):
            llm.NonlinearContactProblem(F, u, interfaces=[interface])
