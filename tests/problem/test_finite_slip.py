"""What sides tell at finite deformation, by positions alone: slip, gap, who touches."""

import finite_patch
import numpy as np
import patch2d
import pytest
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem
from mpi4py import MPI
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF
YOUNG, POISSON = (1000.0, 2000.0), (0.4, 0.3)


def boxes(dim, low, high):
    """Foundation and punch with their cells, both from the plane that they do not leave on."""
    y = (1.0,) * (dim - 2)
    size, other = (1.5, *y, 1.0), (1.0, *y, 1.0)
    return ((0.0,) * dim, size, (*low, 1)), ((0.0,) * (dim - 1) + (1.0,), other, (*high, 1))


@pytest.mark.parametrize(
    ("kind", "low", "high", "law", "more"),
    [
        longer("quad", (4,), (3,), llm.Frictionless(), {}),
        ("tri", (4,), (5,), llm.Coulomb(1e-9), {"degree": 2}),
        longer("quad", (12,), (9,), llm.Coulomb(0.0), {"order": (1, 0)}),
        longer("quad", (4,), (3,), llm.Coulomb(1e-9), {"degree": 2, "order": (1, 0)}),
        ("hex", (4, 2), (3, 3), llm.Coulomb(1e-9), {"order": (1, 0)}),
        longer("tet", (4, 2), (3, 3), llm.Frictionless(), {"degree": 2}),
    ],
)
def test_slip_in_the_patch(kind, low, high, law, more):
    """Bodies that stretch unlike: each node tells the difference of the stretches times its place,
    in any increments, up to the end of the contact; beyond it there is none, and nothing else."""
    dim = 1 + len(low) if len(low) > 1 else 2
    both = boxes(dim, low, high)
    scene = patch2d.bodies(COMM, kind, separate=True, boxes=both, rough=0.2)
    own = [finite_patch.stretches(300.0, *m)[0] for m in zip(YOUNG, POISSON)]
    for increments in (1, 3):
        problem = finite_patch.problem(
            scene, law=law, young=YOUNG, poisson=POISSON, boxes=both, **more
        )
        problem.solve(increments)
        sides = problem.results[0].sides[:: -1 if "order" in more else 1]
        for side, by in zip(sides, (own[0] - own[1], own[1] - own[0])):
            within = side.X[:, 0] < 1.0 + 1e-9
            assert (side.status[within] > 0).all() and not side.gap[within].any()
            found = side.slip[within]
            assert np.abs(found[:, 0] - by * side.X[within, 0]).max() < 1e-8
            assert np.abs(found[:, 1:]).max() < 1e-8 and not side.slip[side.status == 0].any()
        side, result = sides[0], problem.results[0]
        beyond = side.X[:, 0] > 1.4  # the last facet ends there, of which nothing is covered
        assert beyond.any() and not side.status[beyond].any() and np.isinf(side.gap[beyond]).all()
        if len(side.x) == len(result.frame_status):
            assert not result.pressure[beyond].any() and not result.frame_status[beyond].any()


@pytest.mark.parametrize(
    ("kind", "cells", "degree"),
    [("quad", 5, 1), ("tet", 3, 1), longer("tri", 3, 2), longer("hex", 2, 2)],
)
def test_gap_and_status(kind, cells, degree):
    """A punch over a wider foundation: both sides tell the distance where they face each other,
    and infinity where they do not; pressed, those touch that face each other."""
    dim = 2 if kind in ("quad", "tri") else 3
    d, high = dim - 1, 0.05  # the punch ends at nodes of the foundation
    foundation = (*(-0.5,) * d, 0.0), (*(2.0,) * d, 1.0), (*(4,) * d, 1)
    both = foundation, ((*(0.0,) * d, 1.0), (1.0,) * dim, (*(cells,) * d, 1))
    scene = patch2d.bodies(COMM, kind, separate=True, boxes=both)
    scene[1][0].geometry.x[:, d] += high
    functions, forms, bcs, ends = [], [], [], (0.0, 2.0 + high)
    for (domain, _), end in zip(scene, ends):
        V = compat.function_space(domain, degree=degree, shape=(dim,))
        u, moved = fem.Function(V), fem.Constant(domain, (0.0,) * dim)
        at = fem.locate_dofs_geometrical(V, lambda x, end=end: np.isclose(x[d], end))
        forms.append(finite_patch.residual(u, 400.0, 600.0, degree))
        functions.append(u)
        bcs.append(fem.dirichletbc(moved, at, V))
    tags = (scene[0][1], patch2d.FOUNDATION_TOP), (scene[1][1], patch2d.PUNCH_BOTTOM)
    interface = llm.Interface(None, tags, law=llm.Frictionless())
    problem = llm.NonlinearContactProblem(forms, functions, bcs=bcs, interfaces=[interface])
    for down in (0.02, 0.055, 0.03):
        moved.value[d] = -down
        problem.solve()
        apart = down < high
        for side in problem.results[0].sides:
            place = side.X[:, :d]
            opposite = ((place > -1e-9) & (place < 1.0 + 1e-9)).all(axis=1)
            known = np.where(opposite, high - down if apart else 0.0, np.inf)
            assert ((side.status == 3) == (opposite & (not apart))).all()
            assert np.isinf(side.gap[~opposite]).all()
            assert np.abs(side.gap[opposite] - known[opposite]).max() < 1e-12
            zero = np.abs(side.frame_gap).max() < 1e-12
            carries = len(side.x) == len(problem.results[0].frame_status)
            assert zero if carries else np.allclose(side.frame_gap, side.gap, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("degrees", "cells", "base", "swapped"),
    [((2, 2), 4, 10, False), longer((2, 2), 6, 14, False), longer((2, 1), 4, 20, True)],
)
def test_no_farther_than_bodies_move(degrees, cells, base, swapped):
    """A block dragged along a wave: nodes come into contact in the middle of a load step. Functions
    that were fitted to the slip of the pairs about a loaded node of the frame told 9.4 there, on
    the other meshes 2.9 and 1.3."""
    wave = lambda x: 0.05 * np.cos(2.0 * np.pi * x[:, 0])  # noqa: E731
    bent = (
        lambda x: np.column_stack([x[:, 0], x[:, 1] + wave(x) * (1.0 - x[:, 1])]),
        lambda x: np.column_stack([x[:, 0], x[:, 1] + wave(x) * (1.0 + 2.0 * x[:, 1])]),
    )
    boxes = ((cells, cells), (0.0, 0.0), (1.0, 1.0)), ((base, 2), (-1.0, -0.5), (2.5, 0.0))
    scene = [rectangle(COMM, *box, "triangle", move=move) for box, move in zip(boxes, bent)]
    spaces = [compat.function_space(d, degree=k, shape=(2,)) for (d, _), k in zip(scene, degrees)]
    u, ends = ([fem.Function(V) for V in spaces] for _ in range(2))
    bcs = [
        fem.dirichletbc(end, fem.locate_dofs_geometrical(V, lambda x, y=y: np.isclose(x[1], y)))
        for V, end, y in zip(spaces, ends, (1.0, -0.5), strict=True)
    ]
    of = zip(u, (20.0, 10.0), degrees, strict=True)
    forms = [finite_patch.residual(v, *finite_patch.lame(E, 0.3), k) for v, E, k in of]
    tags = [(scene[0][1], BELOW), (scene[1][1], ABOVE)]
    tags = tuple(tags[:: -1 if swapped else 1])
    interface = llm.Interface(None, tags, law=llm.Coulomb(0.3))
    problem = llm.NonlinearContactProblem(forms, u, bcs=bcs, interfaces=[interface])
    before, along = None, 0.0
    for to, pressed, increments in ((0.0, 0.03, 1), (0.39, 0.03, 4), (0.8, 0.05, 5)):
        ends[0].x.array.reshape(-1, 2)[:] = to, -pressed
        problem.solve(increments)
        sides = problem.results[0].sides
        if before is not None:
            of = zip(sides, before, strict=True)
            moved = sum(np.linalg.norm(side.u - was, axis=1).max() for side, was in of)
            told = [np.linalg.norm(side.slip, axis=1).max() for side in sides]
            assert 0.7 * (to - along) < min(told) <= max(told) < moved
        before, along = [side.u.copy() for side in sides], to
