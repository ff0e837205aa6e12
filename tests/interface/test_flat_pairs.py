"""The patch test on any flat pair: kinds of cells, ratios, overlaps, outlines, stacks."""

import numpy as np
import pairs
import pytest
import wall_scenes as walls
from mpi4py import MPI
from sampling import drawn, longer, some_of

import dolfinx_llm as llm
from dolfinx_llm.interface.build import build_interfaces

COMM = MPI.COMM_SELF


@pytest.mark.parametrize("first", some_of(range(100, 140, 8), [100]))
def test_random_pairs(first):
    for seed in range(first, first + 8):
        problem, error = pairs.random_pair(COMM, seed)
        assert error <= 1e-11, (seed, error)
        smallest, largest = problem.results[0].certificate.singular_values
        assert smallest > 0.02 * largest, seed
        assert np.abs(problem.results[0].pressure / pairs.PRESSURE - 1.0).max() < 1e-10, seed


@pytest.mark.parametrize("seed", [112, longer(117), longer(127)])
def test_pressure_where_rows_cancel(seed):
    """Corrected rows leave a frame node at the rim less area than none. A constant pressure is told
    there, where 0 was, and one that varies as well as elsewhere, where the force there over that
    area is off by its double."""
    result = pairs.random_pair(COMM, seed)[0].results[0]
    assert result.frame_area.min() < 0.0
    assert np.abs(result.pressure / pairs.PRESSURE - 1.0).max() < 1e-10
    for slope in ((0.3, 0.0), (0.0, 0.3), (-0.4, 0.2)):
        result = pairs.random_pair(COMM, seed, slope)[0].results[0]
        applied = pairs.PRESSURE * (1.0 + result.x[:, :2] @ slope)
        assert np.abs(result.pressure / applied - 1.0).max() < 0.35


OUTLINES = {
    "L": lambda c: (c[:, 0] < 0.5) | (c[:, 1] < 0.5),
    "annulus": lambda c: np.abs(c - 0.5).max(axis=1) > 0.25,
    "two pieces": lambda c: np.abs(c[:, 0] - 0.5) > 0.25,
}


@pytest.mark.parametrize(
    ("name", "kind", "n"),
    drawn(OUTLINES, ["hexahedron", "tetrahedron"], [(4, 6), (8, 5)], every=2),
)
def test_outlines(name, kind, n):
    """Contact area with a corner, a hole or in two pieces: the upper block stands on feet."""
    low, high = (-1.0, -1.0, 0.0), (1.0, 1.0, 1.0)
    mask = OUTLINES[name]
    n_upper = 4 * n[1]

    lower = pairs.block(COMM, (n[0], n[0] + 1, 2), low, high, "hexahedron")
    upper = pairs.block(
        COMM, (n_upper, n_upper, 1), (-0.9, -0.8, 1.0), (0.7, 0.9, 2.0), kind, mask=mask
    )
    problem, error = pairs.stack([lower, upper], low, high)
    assert error <= 1e-11
    fraction = {"L": 0.75, "annulus": 0.75, "two pieces": 0.5}[name]
    assert abs(problem.geometries[0].area - fraction * 1.6 * 1.7) < 1e-12


def test_three_blocks():
    """Two interfaces, one body touched on both sides."""
    low, high = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    blocks = [
        pairs.block(COMM, (4, 4, 2), low, high, "hexahedron"),
        pairs.block(COMM, (3, 5, 1), (0.1, 0.0, 1.0), (0.9, 1.0, 1.5), "tetrahedron"),
        pairs.block(COMM, (6, 4, 2), (0.0, 0.2, 1.5), (1.0, 1.3, 2.5), "hexahedron"),
    ]
    problem, error = pairs.stack(blocks, low, high)
    assert error <= 1e-11
    assert len(problem.results) == 2
    areas = [problem.geometries[k].area for k in (0, 1)]
    assert np.allclose(areas, [0.8, 0.8 * 0.8], rtol=1e-12)
    for result, area in zip(problem.results, areas, strict=True):
        assert np.allclose(result.resultant, [0, 0, pairs.PRESSURE * area], atol=1e-9)
        assert np.abs(result.pressure / pairs.PRESSURE - 1.0).max() < 1e-11


def side_by_side(lateral):
    """A base that carries two blocks; ``lateral``: these are tied to each other as well."""
    low, high = (0.0, 0.0, 0.0), (2.0, 1.0, 1.0)
    return pairs.stack(
        [
            pairs.block(COMM, (5, 4, 2), low, high, "hexahedron"),
            pairs.block(COMM, (3, 4, 2), (0.0, 0.0, 1.0), (0.9, 1.0, 2.0), "hexahedron", x_high=7),
            pairs.block(COMM, (4, 3, 3), (0.9, 0.0, 1.0), (2.0, 1.0, 2.0), "tetrahedron", x_low=8),
        ],
        low,
        high,
        ties=[(0, pairs.ABOVE, 1, pairs.BELOW), (0, pairs.ABOVE, 2, pairs.BELOW)]
        + ([(1, 7, 2, 8)] if lateral else []),
    )


def test_nodes_in_two_interfaces():
    """Nodes of the base under the joint of two blocks take part in both interfaces."""
    problem, error = side_by_side(lateral=False)
    shared = np.intersect1d(*(geometry.pairs[0].dofs for geometry in problem.geometries))
    assert len(shared) > 0
    assert error <= 1e-11
    for result in problem.results:
        assert np.abs(result.pressure / pairs.PRESSURE - 1.0).max() < 1e-11


def test_three_blocks_in_a_loop():
    """The joint is tied as well; what passes where the three meet is the same either way."""
    problem, error = side_by_side(lateral=True)
    assert problem.operators.redundant.any() and "rows follow from others" in str(problem)
    assert error <= 1e-11


@pytest.mark.parametrize(
    "lift, words", [((4.0, 0.0), "lie 4 apart"), ((0.1, 0.05), "not parallel")]
)
def test_sides_apart_or_tilted(lift, words):
    low, high = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    lower = pairs.block(COMM, (4, 4, 2), low, high, "hexahedron")
    upper = pairs.block(COMM, (3, 3, 2), (0.0, 0.0, 1.0), (1.0, 1.0, 2.0), "hexahedron")
    x = upper[0].geometry.x
    x[:, 2] += lift[0] + lift[1] * x[:, 0]
    with pytest.raises(llm.ContactError, match=words):
        pairs.stack([lower, upper], low, high, ties=[(0, pairs.ABOVE, 1, pairs.BELOW)])


def test_users_frame_of_triangles():
    """A frame of the user's own, triangles between bricks and tetrahedra."""
    low, high = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    line = np.linspace(0.0, 1.0, 5)
    x, y = (g.ravel() for g in np.meshgrid(line, line, indexing="ij"))
    corner = (np.arange(4)[:, None] * 5 + np.arange(4)).ravel()[:, None]
    cells = np.concatenate([corner + [0, 5, 6], corner + [0, 6, 1]])
    frame = llm.Frame(np.column_stack([x, y, np.ones(25)]), cells)
    blocks = [
        pairs.block(COMM, (5, 5, 2), low, high, "hexahedron"),
        pairs.block(COMM, (6, 7, 2), (0.0, 0.0, 1.0), (1.0, 1.0, 2.0), "tetrahedron"),
    ]
    problem, error = pairs.stack(blocks, low, high, frame)
    assert error <= 1e-11
    assert problem.results[0].frame.cells.shape == (32, 3)


def test_frame_from_gmsh():
    """A frame that gmsh meshed, between two boxes; an unknown group is refused."""
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.occ.addRectangle(0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [1], 5)
    for name in ("Mesh.MeshSizeMin", "Mesh.MeshSizeMax"):
        gmsh.option.setNumber(name, 0.3)
    gmsh.model.mesh.generate(2)
    frame = llm.Frame.from_gmsh(gmsh.model, 5, COMM)
    with pytest.raises(llm.ContactInputError, match="cells must be"):
        llm.Frame.from_gmsh(gmsh.model, 6, COMM)
    gmsh.finalize()
    low, high = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    blocks = [
        pairs.block(COMM, (5, 4, 2), low, high, "hexahedron"),
        pairs.block(COMM, (6, 7, 2), (0.0, 0.0, 1.0), (1.0, 1.0, 2.0), "tetrahedron"),
    ]
    problem, error = pairs.stack(blocks, low, high, frame)
    assert error <= 1e-11
    assert np.array_equal(problem.results[0].frame.x, frame.x)


@pytest.mark.parametrize("cells", [2, longer(1), longer(4)])
@pytest.mark.parametrize("kind", ["triangle", longer("tetrahedron")])
def test_single_facets_that_may_part(kind, cells):
    """A joint of one facet covers what the drawing says, also where it is turned: by rounding it
    was given up, or half of it."""
    blocks = walls.courses(2, 2, bond=0.3, depth=0.7 if kind == "tetrahedron" else None)
    counts = np.where(np.arange(len(blocks))[:, None] % 2, cells, np.ones(blocks.shape[2], int))
    for turn in (0.0, 0.3, 0.7):
        wall = walls.Wall(COMM, blocks, counts, kind, turn=turn)
        free = np.zeros(wall.V.dofmap.index_map.size_local * wall.gdim, dtype=bool)
        built = build_interfaces(wall.interfaces(llm.Coulomb(0.6)), [wall.V], [free])
        for (i, axis, j), geometry in zip(wall.faces, built, strict=True):
            shared = np.minimum(*blocks[[i, j], 1]) - np.maximum(*blocks[[i, j], 0])
            assert abs(geometry.area - np.delete(shared, axis).prod()) <= 1e-14
            assert geometry.certificate.residual <= 1e-14
