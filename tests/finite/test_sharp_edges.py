"""Sharp edges in contact: the surface without any carries the frame, however fine it is, and what
is told where both have some."""

import logging
import re

import finite_patch
import numpy as np
import pytest
import ufl
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem, mesh
from dolfinx.fem.petsc import assemble_vector
from mpi4py import MPI
from patch2d import FOUNDATION_TOP, PUNCH_BOTTOM, bodies
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.geometry.cells import outline_edges, vector_areas
from dolfinx_llm.geometry.divided import divided
from dolfinx_llm.geometry.drawn import edges
from dolfinx_llm.geometry.surface import extract_surface

pytestmark = pytest.mark.quick
CREST = [0.0, 0.8, 1.2, 2.0], [-0.1, 0.15, -0.15, -0.15]  # the upper side of a barb


def wedge(x):
    """A square's lower side as a ridge of 90 degrees at (0.03, 0)."""
    return np.column_stack([x[:, 0], x[:, 1] + (1.0 - x[:, 1] / 1.2) * np.abs(x[:, 0] - 0.03)])


def chamfered(x):
    """A block's upper side with edges of 45 degrees at its ends."""
    return np.column_stack([x[:, 0], x[:, 1] - (x[:, 1] + 1.0) * (np.abs(x[:, 0]) - 0.75).clip(0)])


def barbed(x):
    """A block's upper side as a barb."""
    return np.column_stack([x[:, 0], x[:, 1] + (2.0 * x[:, 1] + 1.0) * np.interp(x[:, 0], *CREST)])


def stepped(angle):
    """A square's lower side, flat up to an edge of so many degrees at (0.03, 0)."""

    def move(x):
        rise = np.tan(np.radians(angle)) * (x[:, 0] - 0.03).clip(0)
        return np.column_stack([x[:, 0], x[:, 1] + (1.0 - x[:, 1] / 1.2) * rise])

    return move


class Ridge:
    """A stiff ridge over a soft block, of so many cells along x each, and of an order."""

    def __init__(self, cells, move=None, swapped=False, degree=1, law=None, ridge=wedge, **options):
        comm = MPI.COMM_SELF
        low = rectangle(comm, (cells[1], 4), (-1.0, -1.0), (1.0, 0.0), "quadrilateral", move=move)
        high = rectangle(
            comm, (cells[0], 3), (-0.97, 0.0), (1.03, 1.2), "quadrilateral", move=ridge
        )
        spaces = [compat.function_space(d, degree=degree, shape=(2,)) for d, _ in (high, low)]
        self.u, self.ends = ([fem.Function(V) for V in spaces] for _ in range(2))
        held = (lambda x: np.isclose(x[1], 1.2)), (lambda x: np.isclose(x[1], -1.0))
        bcs = [
            fem.dirichletbc(end, fem.locate_dofs_geometrical(V, where))
            for V, end, where in zip(spaces, self.ends, held, strict=True)
        ]
        self.forms = [
            finite_patch.residual(v, *finite_patch.lame(E, 0.3), degree)
            for v, E in zip(self.u, (100.0, 1.0), strict=True)
        ]
        self.order = -1 if swapped else 1
        sides = ((high[1], BELOW), (low[1], ABOVE))[:: self.order]
        interface = llm.Interface(None, sides, law=law or llm.Frictionless())
        self.problem = llm.NonlinearContactProblem(
            self.forms, self.u, bcs=bcs, interfaces=[interface], **options
        )

    def press(self, down):
        """Both sides' results, ridge first, and how deep the ridge's nodes are in the block."""
        self.ends[0].x.array[1::2] = -down
        self.problem.solve(2)
        ridge, block = self.problem.results[0].sides[:: self.order]
        order = block.x[:, 0].argsort()
        return ridge, block, (np.interp(ridge.x[:, 0], *block.x[order].T) - ridge.x[:, 1]).max()


@pytest.mark.parametrize("cells", [(4, 16), (4, 48), longer((16, 8))])
@pytest.mark.parametrize("swapped", [False, longer(True)])
def test_edge_of_any_mesh(cells, swapped, caplog):
    """The ridge does not go into the block, however coarse it is, and presses as a finer one does;
    forces of both sides balance and meet the bodies' own. There is nothing to tell."""
    scene, fine = (Ridge(c, swapped=swapped) for c in (cells, (2 * cells[1], cells[1])))
    with caplog.at_level(logging.WARNING, "dolfinx_llm"):
        for down in (0.05, 0.12):
            ridge, block, depth = scene.press(down)
            assert depth < 0.005 * 2.0 / cells[1]
            total = ridge.force.sum(axis=0)
            np.testing.assert_allclose(total, -block.force.sum(axis=0), atol=1e-12)
            np.testing.assert_allclose(ridge.normal_force[ridge.status == 0], 0.0, atol=1e-12)
            assert (ridge.gap[ridge.status > 0] == 0.0).all() and (ridge.status > 0).any()
            same = fine.press(down)[0].force.sum(axis=0)
            assert abs(total[1] / same[1] - 1.0) < 0.05
    for form, u, side in zip(scene.forms, scene.u, (ridge, block), strict=True):
        X = u.function_space.tabulate_dof_coordinates()[:, :2]
        node = np.linalg.norm(X[:, None] - side.X, axis=2).argmin(axis=0)
        own = assemble_vector(fem.form(form)).array.reshape(-1, 2)
        np.testing.assert_allclose(own[node], -side.force, atol=1e-9)
    assert not caplog.messages


def test_all_that_knows_of_divided_facets(tmp_path):
    """Forms of the system agree, a state goes on after it was saved, coefficients of friction are
    given at the nodes that the side has, and other orders of the bodies press alike."""
    law, pressed = llm.Coulomb(0.3), []
    for options in ({}, {"solver": "condensed"}, {"law": llm.Coulomb(np.full(5, 0.3))}):
        scene = Ridge((4, 16), **{"law": law} | options)
        pressed.append(scene.press(0.05)[0].force)
        np.testing.assert_allclose(pressed[-1], pressed[0], atol=1e-9)
    scene.problem.save(tmp_path / "state.npz")
    again = Ridge((4, 16), law=law)
    again.problem.load(tmp_path / "state.npz")
    forces = [s.press(0.08)[0].force for s in (scene, again)]
    np.testing.assert_allclose(forces[1], forces[0], atol=1e-12)
    with pytest.raises(llm.ContactInputError, match="each of 5 nodes"):
        Ridge((4, 16), law=llm.Coulomb(np.full(6, 0.3)))
    second = [Ridge(c, degree=2).press(0.05)[0].force.sum(axis=0)[1] for c in ((4, 16), (32, 16))]
    assert second[0] == pytest.approx(second[1], rel=0.05)


@pytest.mark.parametrize(("cells", "rounded"), [((4, 16), False), ((4, 48), True)])
@pytest.mark.parametrize("swapped", [False, longer(True)])
def test_edges_of_both(cells, rounded, swapped, caplog):
    """Where the block has edges as well, elsewhere, the coarser ridge carries the frame, and its
    edge is no pair; where several nodes of the block lie on it, normals are rounded off. That is
    told, once."""
    scene = Ridge(cells, chamfered, swapped)
    with caplog.at_level(logging.WARNING, "dolfinx_llm"):
        for down in (0.05, 0.12):
            assert scene.press(down)[2] > 0.1 * 2.0 / cells[1]
    assert len(caplog.messages) == 1 + rounded
    told = {"between its nodes, by up to": True, "presses beside sharp edges of": rounded}
    for words, so in told.items():
        assert any(words in said for said in caplog.messages) == so


@pytest.mark.parametrize("degree", [1, longer(2)])
def test_flat_beside_an_edge(degree, caplog):
    """A flat face up to an edge presses on a flat block, and nothing lies beyond the edge: without
    friction nothing is to push along the faces. What does, as the block has edges elsewhere, is
    told with its size; without those nothing does, and there is nothing to tell."""
    pushed = []
    for move in (chamfered, None):
        scene = Ridge((4, 16), move, degree=degree, ridge=stepped(50.0))
        with caplog.at_level(logging.WARNING, "dolfinx_llm"):
            force = scene.press(0.02)[0].force.sum(axis=0)
        pushed.append(abs(force[0] / force[1]))
    (said,) = caplog.messages
    assert "presses beside sharp edges of" in said
    told = int(re.search(r"lean by (\d+)%", said)[1]) / 100.0
    assert pushed[0] > 0.05 and told == pytest.approx(pushed[0], abs=0.05)
    assert pushed[1] < 0.2 * pushed[0]


@pytest.mark.parametrize("angle", [28.0, longer(12.0)])
@pytest.mark.parametrize("degree", [1, 2])
def test_flat_beside_an_edge_that_is_not_sharp(degree, angle, caplog):
    """The same of less than 30 degrees: forces are those of a finer face, and go across it."""
    coarse, fine = (
        Ridge(cells, degree=degree, ridge=stepped(angle)).press(0.02)[0].force.sum(axis=0)
        for cells in ((4, 16), (32, 16))
    )
    assert abs(coarse[0]) < 0.01 * abs(coarse[1])
    assert coarse[1] == pytest.approx(fine[1], rel=0.03)
    assert not caplog.messages


@pytest.mark.parametrize(
    ("kind", "angle", "cells"),
    [("hex", 28.0, (12, 5)), ("tet", 50.0, (12, 5)), longer("hex", 50.0, (10, 10))]
    + [longer("tet", 28.0, (16, 6)), longer("hex", 50.0, (7, 7))],
)
def test_flat_beside_an_edge_in_space(kind, angle, cells):
    """The same on a finer block: pairs of divided facets are no more than the frame's nodes, and
    come to rest."""
    boxes = (
        ((-1.0, -0.5, 0.0), (2.0, 1.0, 1.0), (*cells, 3)),
        ((-0.97, -0.45, 1.0), (2.0, 0.9, 1.2), (4, 4 if cells[0] == 7 else 3, 2)),
    )
    (low, low_tags), (high, high_tags) = bodies(MPI.COMM_SELF, kind, 1, True, boxes=boxes)
    x = high.geometry.x
    rise = np.tan(np.radians(angle)) * (x[:, 0] - 0.03).clip(0)
    x[:, 2] += (1.0 - (x[:, 2] - 1.0) / 1.2) * rise
    spaces = [compat.function_space(d, shape=(3,)) for d in (low, high)]
    u, ends = ([fem.Function(V) for V in spaces] for _ in range(2))
    bcs = [
        fem.dirichletbc(end, fem.locate_dofs_geometrical(V, lambda p, z=z: np.isclose(p[2], z)))
        for V, end, z in zip(spaces, ends, (0.0, 2.2), strict=True)
    ]
    forms = [
        finite_patch.residual(v, *finite_patch.lame(E, 0.3), 1)
        for v, E in zip(u, (1.0, 100.0), strict=True)
    ]
    sides = (high_tags, PUNCH_BOTTOM), (low_tags, FOUNDATION_TOP)
    interface = llm.Interface(None, sides, law=llm.Frictionless())
    problem = llm.NonlinearContactProblem(forms, u, bcs=bcs, interfaces=[interface])
    ends[1].x.array[2::3] = -0.02
    problem.solve(2)
    force = problem.results[0].sides[0].force.sum(axis=0)
    assert force[2] < 0.0 and abs(force[0]) < 0.01 * abs(force[2])
    assert len(problem.history) < 20


@pytest.mark.parametrize("cells", [8, longer(12)])
def test_no_energy_from_nothing(cells):
    """A soft strip under a roof is pushed over the sharp crest of a barb with the larger facets:
    what it stores is what the push has put in, as far as steps and facets tell; by normals that are
    rounded off at the crest 1.3 times what is stored came from nothing."""
    comm = MPI.COMM_SELF
    low = rectangle(comm, (10, 1), (0.0, -0.5), (2.0, 0.0), "quadrilateral", move=barbed)
    high = rectangle(comm, (cells, 2), (-1.2, 0.0), (0.05, 0.45), "quadrilateral")
    spaces = [compat.function_space(d, shape=(2,)) for d, _ in (low, high)]
    u, push = [fem.Function(V) for V in spaces], fem.Constant(high[0], 0.0)
    bcs = [
        fem.dirichletbc(
            fem.Function(spaces[0]),
            fem.locate_dofs_geometrical(spaces[0], lambda x: np.isclose(x[1], -0.5)),
        )
    ]
    end, roof = (lambda x: np.isclose(x[0], -1.2)), (lambda x: np.isclose(x[1], 0.45))
    for k, where, value in ((0, end, push), (1, roof, fem.Constant(high[0], 0.0))):
        V = spaces[1].sub(k)
        dofs = fem.locate_dofs_geometrical((V, V.collapse()[0]), where)
        bcs.append(fem.dirichletbc(value, dofs[0], V))
    both = list(zip(u, (finite_patch.lame(E, 0.3) for E in (100.0, 1.0)), strict=True))
    forms = [finite_patch.residual(v, *of) for v, of in both]
    stored = [fem.form(finite_patch.energy(v, *of) * ufl.dx(degree=4)) for v, of in both]
    interface = llm.Interface(None, ((low[1], ABOVE), (high[1], BELOW)), law=llm.Frictionless())
    problem = llm.NonlinearContactProblem(forms, u, bcs=bcs, interfaces=[interface])
    at = fem.locate_dofs_geometrical(spaces[1], end)
    work, before = 0.0, 0.0
    for k in range(15):
        push.value = 0.1 * (k + 1)
        problem.solve()
        force = assemble_vector(fem.form(forms[1])).array.reshape(-1, 2)[at, 0].sum()
        work, before = work + 0.05 * (force + before), force
    energy = sum(fem.assemble_scalar(form) for form in stored)
    assert abs(energy - work) < 0.4 * energy


@pytest.mark.parametrize(
    ("kind", "degree"),
    [("triangle", 1), ("quadrilateral", 2), ("tetrahedron", 1), ("tetrahedron", 2)]
    + [("hexahedron", 1), ("hexahedron", 2)],
)
def test_divided_facets(kind, degree):
    """Parts of facets enclose the same body and join without gaps; own nodes come first."""
    comm, gdim, parts = MPI.COMM_SELF, 2 if kind in ("triangle", "quadrilateral") else 3, 3
    make = mesh.create_unit_square if gdim == 2 else mesh.create_unit_cube
    domain = make(comm, *[2] * gdim, getattr(mesh.CellType, kind))
    facets = mesh.locate_entities_boundary(domain, gdim - 1, lambda x: x[0] > -1.0)
    tags = mesh.meshtags(domain, gdim - 1, facets, np.ones(len(facets), dtype=np.int32))
    V = compat.function_space(domain, degree=degree, shape=(gdim,))
    whole = extract_surface(V, tags, 1)
    found, shares = divided(whole, np.full(len(whole.facets), parts))
    assert len(found.facets) == parts ** (gdim - 1) * len(whole.facets)
    assert not len(outline_edges(found.skin)) and len(np.unique(found.cells)) == len(found.x)
    np.testing.assert_array_equal(found.x[: len(whole.x)], whole.x)
    np.testing.assert_allclose(shares @ whole.x, found.x, atol=1e-14)
    area = vector_areas(found.x, found.facets)
    volume = np.sum(found.x[found.facets].mean(axis=1) * area) / gdim
    assert volume == pytest.approx(1.0, rel=1e-12)
    assert np.ptp(np.linalg.norm(area, axis=1)) < 1e-12


def test_edges_are_told_from_coarse_facets():
    """Corners, roofs and crests are edges; polygons of rings are not, nor is a fillet."""

    def told(x, closed=False):
        at = np.arange(len(x) - (not closed))
        return edges(np.array(x, float), np.column_stack([at, (at + 1) % len(x)]))[3].any()

    for n, has in ((4, True), (8, False), (10, False), (24, False)):
        angle = 2.0 * np.pi * np.arange(n) / n
        assert told(np.column_stack([np.cos(angle), np.sin(angle)]), closed=True) == has
    assert told([(-1.0, -0.5), (0.0, 0.0), (1.0, -0.5)])
    kink = [(-2.0, 0.0), (-1.0, 0.0), (0.0, 0.0), (1.0, -0.25), (2.0, -0.5)]  # 14 degrees
    assert told(kink) and not told(kink[1:4])  # which may be an arc of two facets
    assert told([(0.0, 0.0), (1.0, 0.2), (2.0, 0.4), (3.0, -0.2), (4.0, -0.8)])
    assert not told([(0.0, 0.0), (1.0, 0.0), (1.7, -0.3), (2.0, -1.0), (2.0, -2.0)])
    assert not told([(0.0, 0.0), (1.0, 0.0)])


@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize(("kind", "edge"), [("roof", True), ("kink", True), ("tube", False)])
def test_edges_in_space(kind, edge, parts):
    """Facets along an edge meet at its angle as well; halves of a quadrilateral at none."""
    across, rows = 11, 4
    t = np.linspace(-1.0, 1.0, across)
    angle = np.radians({"roof": 50.0, "kink": 14.0, "tube": 180.0}[kind])
    x, z = (t, -np.tan(angle) * t.clip(0)) if edge else (np.sin(angle * t), np.cos(angle * t))
    x = np.vstack([np.column_stack([x, np.full(across, y), z]) for y in range(rows)])
    at = (np.arange(rows - 1)[:, None] * across + np.arange(across - 1)).ravel()
    quads = np.column_stack([at, at + 1, at + 1 + across, at + across])
    halves = np.vstack([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    i, j, _, found = edges(x, quads if parts == 1 else halves)
    assert found.sum() == (rows - 1 if edge else 0)
