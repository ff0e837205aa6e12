"""Where increments begin does not matter: of one motion on a straight way any increments end in the
same forces, and a load step that changes nothing leaves them alone."""

import finite_patch
import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

LOW, HIGH = ((0.0, 0.0), (2.0, 0.6)), ((0.4, 0.6), (1.0, 0.5))  # corners and sizes
SHORT = ((0.0, 0.0), (1.0, 0.5)), ((0.15, 0.5), (0.7, 0.5))  # its edge comes near
MOTION = 0.2, -0.1


def body(corner, size, cells, held, touch, comm, order=1, wave=0.0):
    """A block's residual and displacement, condition, its value, and tags: 1 is what touches, which
    is drawn as a wave of that height."""
    points = [np.array(corner), np.add(corner, size)]
    domain = mesh.create_rectangle(comm, points, cells, mesh.CellType.quadrilateral)
    found = [
        mesh.locate_entities_boundary(domain, 1, lambda x, y=y: np.isclose(x[1], y))
        for y in (touch, held)
    ]
    tags = mesh.meshtags(domain, 1, np.sort(found[0]), np.ones(len(found[0]), np.int32))
    V = compat.function_space(domain, degree=order, shape=(2,))
    x = domain.geometry.x
    x[:, 1] += wave * np.sin(3.0 * x[:, 0]) * (x[:, 1] - held) / (touch - held)
    u, value = fem.Function(V), fem.Constant(domain, np.zeros(2))
    bc = fem.dirichletbc(value, fem.locate_dofs_topological(V, 1, found[1]), V)
    return finite_patch.residual(u, *finite_patch.lame(1000.0, 0.3)), u, bc, value, tags


def scene(high, low, law, boxes=(LOW, HIGH), comm=MPI.COMM_SELF, **drawn):
    """A block of so many facets on another one, and what moves its top."""
    (corner, size), (above, other) = boxes
    y = corner[1], corner[1] + size[1], above[1] + other[1]
    below = body(corner, size, (low, max(low // 3, 1)), y[0], y[1], comm, **drawn)
    over = body(above, other, (high, high // 2), y[2], y[1], comm, **drawn)
    F, u, bcs, value, tags = zip(below, over)
    interface = llm.Interface(None, ((tags[0], 1), (tags[1], 1)), law=law)
    contact = llm.NonlinearContactProblem(list(F), list(u), bcs=list(bcs), interfaces=interface)
    return contact, value[1]


def solved(contact, **more):
    """Forces on the frame of both sides' nodes, by where they are drawn, and the iterations."""
    contact.solve(**more)
    sides = contact.results[0].sides
    found = [side.force[np.argsort(side.x[:, 0])] for side in sides]
    return np.concatenate(found), len(contact.history)


@pytest.mark.parametrize(
    ("high", "low", "law", "boxes"),
    [
        (12, 18, llm.Frictionless(), (LOW, HIGH)),
        longer(15, 16, llm.Frictionless(), SHORT),
        longer(9, 8, llm.Frictionless(), SHORT),
        longer(12, 10, llm.Frictionless(), SHORT),
        longer(12, 8, llm.Frictionless(), (LOW, HIGH)),
        longer(15, 10, llm.Frictionless(), (LOW, HIGH)),
        (12, 18, llm.Coulomb(0.3), (LOW, HIGH)),  # in gross slip
        longer(9, 8, llm.Coulomb(0.2), SHORT),
    ],
)
def test_any_increments_end_in_the_same_forces(high, low, law, boxes):
    """Blocks that are pressed and slid at once: forces differed by up to 7 % of the largest."""
    ends = []
    for increments in (1, 4) if high == 12 else (1, 2, 4, 8):
        contact, value = scene(high, low, law, boxes)
        value.value = MOTION
        ends.append(solved(contact, increments=increments)[0])
        again, iterations = solved(contact)
        assert np.abs(again - ends[-1]).max() <= 1e-10 * np.abs(again).max()
        assert iterations == 1
    for other in ends[1:]:
        assert np.abs(other - ends[0]).max() <= 1e-8 * np.abs(ends[0]).max()


@pytest.mark.parametrize("cells", [(4, 6), longer((6, 4)), longer((7, 12))])
def test_second_order_friction_on_a_wave_stays_where_it_is(cells):
    """Pairs of second-order bodies are made of several nodes, which stand above a curved frame
    along normals of their own: that is no slip. Each load step moved what sticks by it, so that one
    that changes nothing changed forces by 4 % of the largest."""
    contact, value = scene(*cells, llm.Coulomb(1.0), order=2, wave=0.1)
    for value.value in ((0.0, -0.05), (0.02, -0.05)):
        before, _ = solved(contact, increments=2)
        slipping = [side.status == 2 for side in contact.results[0].sides]
        assert not np.concatenate(slipping).all()
        for _ in range(2):
            again, iterations = solved(contact)
            assert iterations == 1
            assert np.abs(again - before).max() <= 1e-10 * np.abs(before).max()
