"""Scenes that must be refused, on all ranks together and with the same words.

Every case is a function of a communicator and a pattern of what its message must tell.
"""

import numpy as np
import scenes
import ufl
from dolfinx import fem, mesh

import dolfinx_llm as llm
from dolfinx_llm import compat

CASES = {}


def case(words: str, kind=llm.ContactError):
    """Register a scene; ``kind`` is the error's class."""

    def register(function):
        CASES[function.__name__] = (function, words, kind)
        return function

    return register


INPUT = llm.ContactInputError


def blocks(comm, solve=False, **kwargs):
    """The two blocks with something wrong about them."""
    V, tags = scenes.two_blocks(comm)
    contact = scenes.block_problem(V, tags, **kwargs)
    return contact.solve() if solve else contact


def flat_frame(n, low=(0.0, 0.0), high=(1.0, 1.0)):
    x, quads = scenes.grid(n, n, low, high)
    return np.column_stack([x, np.ones(len(x))]), quads


# Surfaces


@case(r"no facet has tag 99; .*\[1, 2, 3, 4\]", INPUT)
def tag_without_facets(comm):
    blocks(comm, sides=(2, 99))


@case(r"no facet has tag 77", INPUT)
def load_on_a_tag_without_facets(comm):
    V, tags = scenes.two_blocks(comm)
    llm.free_surface_load(V, tags, 77, 1.0)


@case(r"lie 2 apart along the normal, .*; what covers a surface lies across from it")
def cover_on_the_far_side_of_a_body(comm):
    V, tags = scenes.two_blocks(comm)
    llm.free_surface_load(V, tags, 4, 1.0, covered_by=(tags, 1))


@case(r"tag 2 and tag 3 do not overlap: .* span .*Check tags")
def surfaces_apart(comm):
    sections = (scenes.grid(4, 4), scenes.grid(3, 3, low=(5.0, 0.0), high=(6.0, 1.0)))
    domain, tags = scenes.stacked(comm, sections, (0.0, 1.0, 2.0))
    scenes.block_problem(compat.function_space(domain, shape=(3,)), tags)


@case(r"do not overlap")
def surfaces_that_meet_at_an_edge(comm):
    sections = (scenes.grid(4, 4), scenes.grid(3, 3, low=(1.0, 0.0), high=(2.0, 1.0)))
    domain, tags = scenes.stacked(comm, sections, (0.0, 1.0, 2.0))
    scenes.block_problem(compat.function_space(domain, shape=(3,)), tags)


def one_box(comm, ghosts=mesh.GhostMode.shared_facet):
    kind = mesh.CellType.hexahedron
    domain = mesh.create_box(
        comm, [[0, 0, 0], [1, 1, 2]], [3, 3, 4], cell_type=kind, ghost_mode=ghosts
    )
    return domain, compat.function_space(domain, shape=(3,))


@case(r"tag 2: 9 tagged facets lie inside the mesh", INPUT)
def facets_inside_one_body(comm, ghosts=mesh.GhostMode.shared_facet):
    domain, V = one_box(comm, ghosts)
    inside = mesh.locate_entities(domain, 2, scenes.on(2, 1.0))
    top = mesh.locate_entities_boundary(domain, 2, scenes.on(2, 2.0))
    values = [np.full(len(f), t, np.int32) for f, t in ((inside, 2), (top, 4))]
    tags = scenes.tags_from(domain, [inside, top], values)
    scenes.block_problem(V, tags, sides=(2, 4))


@case(r"tag 2: 9 tagged facets lie inside the mesh", INPUT)
def facets_inside_one_body_without_ghost_cells(comm):
    facets_inside_one_body(comm, mesh.GhostMode.none)


@case(r"tag 2 and tag 3 share 4 nodes, e.g. at \[\[1.0")
def surfaces_that_share_nodes(comm):
    domain, V = one_box(comm)
    one = mesh.locate_entities_boundary(domain, 2, scenes.on(2, 2.0))
    two = mesh.locate_entities_boundary(domain, 2, scenes.on(0, 1.0))
    values = [np.full(len(f), t, np.int32) for f, t in ((one, 2), (two, 3))]
    scenes.block_problem(V, scenes.tags_from(domain, [one, two], values), loads=[])


@case(r"share 25 nodes")
def one_surface_on_both_sides(comm):
    blocks(comm, sides=(2, 2))


@case(r"tag 2, \[.*1.0\], and tag 4, \[.*1.0\], point the same way")
def surfaces_that_face_the_same_way(comm):
    blocks(comm, sides=(2, 4))


@case(r"facet tags of dimension 3 do not mark facets, which have dimension 2", INPUT)
def tags_of_cells(comm):
    V, _ = scenes.two_blocks(comm)
    cells = np.arange(V.mesh.topology.index_map(3).size_local, dtype=np.int32)
    tags = mesh.meshtags(V.mesh, 3, cells, np.full(len(cells), 2, dtype=np.int32))
    scenes.block_problem(V, tags, loads=[])


@case(r"facet tags belong to none of the meshes", INPUT)
def tags_of_another_mesh(comm):
    made = [scenes.two_blocks(comm) for _ in range(3)]
    a, L = zip(*(scenes.forms(V) for V, _ in made[:2]), strict=True)
    llm.ContactProblem(a, L, interfaces=[llm.Interface(made[2][1], (2, 3))])


@case(r"interfaces 2 . 3 and 3 . 2 have 16 and 9 facets of both sides in common", INPUT)
def one_surface_in_two_interfaces(comm):
    V, tags = scenes.two_blocks(comm)
    a, L = scenes.forms(V)
    both = [llm.Interface(tags, (2, 3)), llm.Interface(tags, (3, 2))]
    llm.ContactProblem(a, L, bcs=scenes.hold(V, scenes.SYMMETRY), interfaces=both)


@case(r"RigidPlane and 3 . RigidPlane are of the same obstacle and have 9 facets in common", INPUT)
def one_obstacle_twice(comm):
    V, tags = scenes.two_blocks(comm)
    a, L = scenes.forms(V)
    plane = llm.RigidPlane((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    both = [llm.Interface(tags, (3, plane), law=law) for law in (llm.Frictionless(), llm.Tied())]
    llm.ContactProblem(a, L, bcs=scenes.hold(V, scenes.SYMMETRY), interfaces=both)


# Frames


@case(r"does not cover the contact area: \d+ of 25 nodes of tag 2 .*Extend the frame", INPUT)
def frame_too_small(comm):
    blocks(comm, frame=llm.Frame(*flat_frame(3, high=(0.6, 1.0))))


@case(r"cells \[\d.*are inverted or degenerate", INPUT)
def frame_with_an_inverted_cell(comm):
    x, cells = flat_frame(3)
    x[5, :2] = [0.9, 0.9]
    blocks(comm, frame=llm.Frame(x, cells))


@case(r"inverted", INPUT)
def frame_with_a_turned_cell(comm):
    x, cells = flat_frame(3)
    cells[4] = cells[4][::-1]
    blocks(comm, frame=llm.Frame(x, cells))


@case(r"cells \[0\] are inverted or degenerate", INPUT)
def frame_with_a_degenerate_cell(comm):
    x, cells = flat_frame(3)
    x[0] = 0.5 * (x[1] + x[4])
    blocks(comm, frame=llm.Frame(x, cells))


@case(r"frame lies in 2D, the bodies in 3D", INPUT)
def frame_of_another_dimension(comm):
    blocks(comm, frame=llm.Frame([[0.0, 1.0], [1.0, 1.0]], [[0, 1]]))


@case(r"frame is too fine: 169 nodes against 25 \+ 16 .*frame nodes \[\d+, \d+")
def frame_with_more_nodes_than_the_surfaces(comm):
    blocks(comm, frame=llm.Frame(*flat_frame(12)), design=None)


@case(r"frame is too fine.* singular values .* hold the frame nodes \[\d+, \d+.* at \[\[")
def frame_without_full_rank(comm):
    """Fewer nodes than the surfaces together, cells finer than either side's."""
    blocks(comm, frame=llm.Frame(*flat_frame(5)), design=None)


@case(r"frame nodes \[\d+, \d+")
def frame_too_fine_for_the_design(comm):
    blocks(comm, frame=llm.Frame(*flat_frame(6)), design="weights")


@case(r"frame is too fine.*frame nodes \[\d+, \d+")
def large_frame_without_full_rank(comm):
    """Over 600 frame nodes: singular values by Lanczos' method. Cells are fine near a corner."""
    V, tags = scenes.two_blocks(comm, 25, 22, layers=(1, 1))
    x, cells = flat_frame(26)
    scenes.block_problem(V, tags, frame=llm.Frame(x**1.7, cells), design=None)


# Supports


@case(r"3 rigid motion\(s\) are held by no support .*body 0 \(from .*body 1 \(from .* in 3 ind")
def bodies_free_to_slide(comm):
    V, tags = scenes.two_blocks(comm)
    scenes.block_problem(V, tags, bcs=scenes.hold(V, scenes.SYMMETRY[:1]))


@case(r"6 rigid motion\(s\) .*body 0 .*body 1 .* in 6 independent")
def bodies_without_supports(comm):
    V, tags = scenes.two_blocks(comm)
    scenes.block_problem(V, tags, bcs=[])


@case(r"6 rigid motion\(s\) .* move body \d \(from \[0.0, 0.0, 2.0\] to .* in 6 independent")
def a_body_that_nothing_holds(comm):
    sections = [scenes.grid(n, n) for n in (4, 3, 2)]
    domain, tags = scenes.stacked(comm, sections, (0.0, 1.0, 2.0, 3.0), layers=(2, 2, 1))
    V = compat.function_space(domain, shape=(3,))
    bcs = scenes.hold(V, [(k, scenes.on(2, 0.0)) for k in range(3)])
    scenes.block_problem(V, tags, bcs=bcs, loads=[])


# Loads, forms and spaces


@case(r"the load has \d+ entries that are NaN or infinite")
def nan_in_the_form(comm):
    V, tags = scenes.two_blocks(comm)
    a, _ = scenes.forms(V)
    force = fem.Constant(V.mesh, np.array([0.0, np.nan, 0.0]))
    llm.ContactProblem(
        a,
        ufl.inner(force, ufl.TestFunction(V)) * ufl.dx,
        bcs=scenes.hold(V, scenes.SYMMETRY),
        interfaces=[llm.Interface(tags, (2, 3))],
    ).solve()


@case(r"the load has 1 entries that are NaN or infinite")
def nan_in_a_nodal_load(comm):
    V, tags = scenes.two_blocks(comm)
    load = fem.Function(V)
    x = V.tabulate_dof_coordinates()
    corner = np.flatnonzero((np.abs(x - [1.0, 1.0, 2.0]) < 1e-9).all(axis=1))
    load.x.array[3 * corner + 1] = np.nan
    scenes.block_problem(V, tags, loads=[load]).solve()


@case(r"NaN or infinite")
def nan_in_a_support(comm):
    V, tags = scenes.two_blocks(comm)
    bcs = scenes.hold(V, scenes.SYMMETRY, lambda p: np.full_like(p, np.nan))
    scenes.block_problem(V, tags, bcs=bcs).solve()


@case(r"NaN|not finite|infinite")
def nan_in_the_stiffness(comm):
    V, tags = scenes.two_blocks(comm)
    scenes.block_problem(V, tags, scale=fem.Constant(V.mesh, np.nan)).solve()


def one_block_alone(comm, law, **options):
    """Two blocks, of which the form leaves the upper one out."""
    V, tags = scenes.two_blocks(comm)
    dofs = compat.cell_dofs(V.mesh.geometry)
    above = (V.mesh.geometry.x[dofs].mean(axis=1)[:, 2] > 1.0).astype(np.int32)
    cells = np.arange(len(above), dtype=np.int32)
    dx = ufl.Measure("dx", V.mesh, subdomain_data=mesh.meshtags(V.mesh, 3, cells, above))
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    a, (_, L) = ufl.inner(scenes.stress(u), ufl.grad(v)) * dx(0), scenes.forms(V)
    bcs = scenes.hold(V, [(k, scenes.on(2, z)) for k in range(3) for z in (0.0, 2.0)])
    interfaces = llm.Interface(tags, (2, 3), law=law)
    return llm.ContactProblem(a, L, bcs=bcs, interfaces=interfaces, **options)


BARE = r"of \d+ free displacements have no stiffness, at nodes from \[0.0, 0.0, 1.0\] to \[1.0, "


@case(BARE + ".*dx.* leave a body out", INPUT)
def a_body_without_a_form(comm):
    one_block_alone(comm, llm.Tied())


@case(BARE + ".*dx.* leave a body out", INPUT)
def a_body_without_a_form_condensed(comm):
    one_block_alone(comm, llm.Frictionless(), solver="condensed")


@case(r"\d+ of \d+ free displacements have no stiffness", INPUT)
def stiffness_that_became_zero(comm):
    V, tags = scenes.two_blocks(comm)
    E = fem.Constant(V.mesh, 1.0)
    problem = scenes.block_problem(V, tags, scale=E)
    problem.solve()
    E.value = 0.0
    problem.solve()


@case(r"\d+ of \d+ free displacements have a negative stiffness.*E > 0", INPUT)
def negative_modulus(comm):
    V, tags = scenes.two_blocks(comm)
    scenes.block_problem(V, tags, scale=fem.Constant(V.mesh, -1.0)).solve()


@case(r"vector space of first or second order .* 64 nodes per cell .* all that is left", INPUT)
def third_order_space(comm):
    V, tags = scenes.two_blocks(comm, 2, 1)
    W = compat.function_space(V.mesh, degree=3, shape=(3,))
    a, L = scenes.forms(W)
    llm.ContactProblem(a, L, interfaces=[llm.Interface(tags, (2, 3))])


def conducting(comm, law, sides=(2, 3)):
    """A temperature in two blocks."""
    V, tags = scenes.two_blocks(comm)
    W = compat.function_space(V.mesh)
    u, w = ufl.TrialFunction(W), ufl.TestFunction(W)
    a = ufl.inner(ufl.grad(u), ufl.grad(w)) * ufl.dx
    L = fem.Constant(V.mesh, 0.0) * w * ufl.dx
    bcs = [fem.dirichletbc(fem.Function(W), fem.locate_dofs_geometrical(W, scenes.on(2, 0.0)))]
    return llm.ContactProblem(a, L, bcs=bcs, interfaces=llm.Interface(tags, sides, law=law))


@case(r"Frictionless\(\) is for displacements; a scalar", INPUT)
def friction_of_heat(comm):
    conducting(comm, llm.Frictionless())


@case(r"gap=0.1\) is for displacements; a scalar", INPUT)
def gap_of_heat(comm):
    conducting(comm, llm.Tied(gap=0.1))


@case(r"a rigid obstacle has no temperature", INPUT)
def heat_into_an_obstacle(comm):
    conducting(comm, llm.Tied(), (3, llm.RigidPlane((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))))


@case(r"Conductance: h at \d+ positions is of -1.0 to -1.0", INPUT)
def negative_conductance(comm):
    conducting(comm, llm.Conductance(lambda x: np.full(len(x), -1.0))).solve()


@case(r"Conductance\(h=2.0\) is for scalar function spaces", INPUT)
def conductance_of_displacements(comm):
    V, tags = scenes.two_blocks(comm)
    a, L = scenes.forms(V)
    interface = llm.Interface(tags, (2, 3), law=llm.Conductance(2.0))
    llm.ContactProblem(a, L, bcs=scenes.hold(V, scenes.SYMMETRY), interfaces=interface)


@case(r"one form a is of displacements, another of a scalar", INPUT)
def heat_in_one_body(comm):
    V, tags = scenes.two_blocks(comm)
    other = scenes.two_blocks(comm)[0].mesh
    W = compat.function_space(other)
    u, w = ufl.TrialFunction(W), ufl.TestFunction(W)
    (a, L), b = scenes.forms(V), ufl.inner(u, w) * ufl.dx
    M = fem.Constant(other, 0.0) * w * ufl.dx
    llm.ContactProblem([a, b], [L, M], interfaces=llm.Interface(tags, (2, 3)))


@case(r"vector space of first or second order .* 1 component\(s\)", INPUT)
def pressure_on_a_temperature(comm):
    V, tags = scenes.two_blocks(comm)
    llm.free_surface_load(compat.function_space(V.mesh), tags, 4, 1.0)


@case(r"vector space of first or second order", INPUT)
def discontinuous_space(comm):
    V, tags = scenes.two_blocks(comm, 2, 1)
    W = compat.function_space(V.mesh, family="DG", shape=(3,))
    llm.free_surface_load(W, tags, 4, 1.0)
