"""The 3D contact patch test of Rebel, Park and Felippa (2001): Tables 1, 2 and 4, and its mesh."""

import numpy as np
from dolfinx import mesh

from dolfinx_llm import compat

FOUNDATION_TOP, PUNCH_BOTTOM, PUNCH_TOP, BOTTOM = 1, 2, 3, 4

E, NU, PRESSURE = 2600.0, 0.3, 260.0
SPACING = 0.35  # lateral mesh of the foundation, nodes at its multiples

# Table 1: cross-section of the punch in the quarter x, y >= 0 (nodes 1 to 10), and its quads.
# Nodes 4 and 8 to 10 are corners of the regular 14-gon in the unit circle: computed here, since
# the printed eight digits would limit the test.
PUNCH_NODES = np.array(
    [
        [0.15104895, 0.0],
        [0.44055944, 0.0],
        [0.70629371, 0.0],
        [1.0, 0.0],
        [0.16083916, 0.40839161],
        [0.46153846, 0.34965035],
        [0.69230769, 0.26573427],
        *([np.cos(k * np.pi / 7.0), np.sin(k * np.pi / 7.0)] for k in (1, 2, 3)),
    ]
)
PUNCH_QUADS = np.array([[1, 2, 6, 5], [2, 3, 7, 6], [3, 4, 8, 7], [5, 6, 9, 10], [6, 7, 8, 9]]) - 1
PUNCH_AXIS_EDGES = np.array([[1, 5], [5, 10]]) - 1  # quads across the y axis: edge and its image

# Table 2: frame in the quarter x, y >= 0, three nodes a row: prediction and optimised.
FRAME_PREDICTION = np.array([[x, y] for y in (0.0, 0.2, 0.7, 1.05) for x in (0.21, 0.63, 1.05)])
FRAME_OPTIMISED = np.array(
    [
        [0.21146205, 0.00000000],
        [0.56401530, 0.00000000],
        [1.05000000, 0.00000000],
        [0.33965412, 0.37074965],
        [0.68689175, 0.30017002],
        [1.05000000, 0.06001071],
        [0.18146139, 0.96891706],
        [0.60713299, 0.73075863],
        [1.05000000, 0.61430709],
        [0.21312353, 1.05000000],
        [0.41996074, 1.05000000],
        [1.05000000, 1.05000000],
    ]
)

# Table 4: nodal normal forces (theoretical) by the node numbers of Figure 12's quarter.
FORCES_FOUNDATION = np.array(
    [31.850000, 31.850000, 31.040561, 9.761253, 31.850000, 31.849998, 28.694115, 5.933156,
     31.053523, 28.686091, 14.321187, 0.689455, 9.642879, 5.971022, 0.710470]
)  # fmt: skip
FORCES_PUNCH = np.array(
    [31.241534, 24.778470, 21.101634, 13.548987, 41.236884, 30.992300, 16.144860, 13.959140,
     21.492565, 28.256039]
)  # fmt: skip


def mirror(nodes: np.ndarray, quads: np.ndarray, axis_edges: np.ndarray):
    """Full cross-section from its quarter: nodes (n, 2) and quads (m, 4), mirrored about both axes.

    Args:
        nodes: quarter nodes, x, y >= 0.
        quads: quads of the quarter, anticlockwise.
        axis_edges: edges (a, b), b above a, that a quad joins with its image across the y axis.
    """
    n = len(nodes)
    images = [nodes * sign for sign in ([1, 1], [-1, 1], [-1, -1], [1, -1])]
    cells = [(quads if k % 2 == 0 else quads[:, ::-1]) + k * n for k in range(4)]
    a, b = axis_edges.T
    cells.append(np.column_stack([a + n, a, b, b + n]))
    cells.append(np.column_stack([a + 3 * n, a + 2 * n, b + 2 * n, b + 3 * n]))
    x, cells = np.concatenate(images), np.concatenate(cells)
    _, first, inverse = np.unique(
        np.round(x, 9) + 0.0, axis=0, return_index=True, return_inverse=True
    )
    return x[first] + 0.0, inverse.ravel()[cells]


def frame_mesh(quarter: np.ndarray):
    """Frame of 6 x 7 nodes (Figure 11) from its quarter: nodes (42, 2) and quads (30, 4)."""
    quads = np.array(
        [[3 * j + i, 3 * j + i + 1, 3 * j + i + 4, 3 * j + i + 3] for j in range(3) for i in (0, 1)]
    )
    edges = np.array([[0, 3], [3, 6], [6, 9]])
    return mirror(quarter, quads, edges)


def refine(x: np.ndarray, quads: np.ndarray, n: int):
    """Split every quad n x n-fold by its bilinear map."""
    u = np.linspace(0.0, 1.0, n + 1)
    s, t = (g.ravel() for g in np.meshgrid(u, u, indexing="ij"))
    N = np.column_stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t])
    points = np.einsum("gk,mki->mgi", N, x[quads])
    corner = np.array(
        [[i, i + n + 1, i + n + 2, i + 1] for i in range((n + 1) * n) if (i + 1) % (n + 1)]
    )
    cells = (np.arange(len(quads))[:, None, None] * (n + 1) ** 2 + corner).reshape(-1, 4)
    _, first, inverse = np.unique(
        np.round(points.reshape(-1, 2), 9) + 0.0, axis=0, return_index=True, return_inverse=True
    )
    return points.reshape(-1, 2)[first] + 0.0, inverse.ravel()[cells]


def extrude(x, quads, z):
    """Bricks (in dolfinx's node order) from plane quads, anticlockwise, and levels z."""
    n = len(x)
    points = np.concatenate([np.column_stack([x, np.full(n, level)]) for level in z])
    layer = np.concatenate([quads[:, [0, 1, 3, 2]], quads[:, [0, 1, 3, 2]] + n], axis=1)
    return points, np.concatenate([layer + k * n for k in range(len(z) - 1)])


def cross_sections(n):
    """Nodes and quads of the foundation's top and of the punch, each split n-fold."""
    line = np.arange(-4 * n, 4 * n + 1) * (SPACING / n)
    k = len(line)
    corner = np.array([i * k + j for i in range(k - 1) for j in range(k - 1)])
    top = np.array([[a, b] for a in line for b in line])
    quads = corner[:, None] + np.array([0, k, k + 1, 1])
    punch = mirror(PUNCH_NODES, PUNCH_QUADS, PUNCH_AXIS_EDGES)
    return (top, quads), refine(*punch, n)


def scene(comm, refine=1, transform=lambda x: x):
    """Mesh and facet tags; ``transform`` moves the points (rotation, scaling, shift)."""
    foundation, punch = cross_sections(refine)
    z = np.linspace(0.0, 1.0, 3 * refine + 1)
    x0, cells0 = extrude(*foundation, z)
    x1, cells1 = extrude(*punch, z + 1.0)
    points, cells = np.concatenate([x0, x1]), np.concatenate([cells0, cells1 + len(x0)])
    if comm.rank > 0:
        points, cells = points[:0], cells[:0]
    domain = compat.create_mesh(comm, cells, points, "hexahedron")
    body = compat.cell_dofs(domain.geometry)[:, 0]
    second = np.asarray(domain.geometry.input_global_indices)[body] >= len(x0)
    domain.topology.create_connectivity(2, 3)
    to_cell = domain.topology.connectivity(2, 3)
    entities, values = [], []
    for tag, height, of_punch in (
        (FOUNDATION_TOP, 1.0, False),
        (PUNCH_BOTTOM, 1.0, True),
        (PUNCH_TOP, 2.0, True),
        (BOTTOM, 0.0, False),
    ):
        found = mesh.locate_entities_boundary(domain, 2, lambda p, h=height: np.isclose(p[2], h))
        facets = found[second[to_cell.array[to_cell.offsets[found]]] == of_punch]
        entities.append(facets)
        values.append(np.full(len(facets), tag, dtype=np.int32))
    entities, values = np.concatenate(entities), np.concatenate(values)
    order = np.argsort(entities)
    tags = mesh.meshtags(domain, 2, entities[order], values[order])
    domain.geometry.x[:] = transform(domain.geometry.x)
    return domain, tags
