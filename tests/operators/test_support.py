"""Motions that nothing holds, by counting: one and two squares on supports, springs and ties."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from scipy.sparse import csr_matrix

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.motions import left_by_supports, rigid_motions
from dolfinx_llm.operators.support import check_support

pytestmark = pytest.mark.quick

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
COMM = MPI.COMM_SELF


class Squares:
    """Unit squares side by side that share no node, of one cell each."""

    def __init__(self, count=1, spring=0.0):
        x = np.concatenate([CORNERS + [2.0 * k, 0.0] for k in range(count)])
        domain = compat.create_mesh(COMM, np.arange(4 * count).reshape(-1, 4), x, "quadrilateral")
        self.V = V = compat.function_space(domain, shape=(2,))
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        a = ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) * ufl.dx
        if spring:
            a += fem.Constant(domain, spring) * ufl.inner(u, w) * ufl.dx
        self.a, self.x = fem.form(a), V.tabulate_dof_coordinates()[:, :2]
        self.bodies = Bodies([V])

    def dof(self, point, component):
        return 2 * int(np.abs(self.x - point).sum(axis=1).argmin()) + component

    def parts(self, held):
        """Bodies, K and what is prescribed, by (point, component)."""
        fixed = np.zeros(self.x.size, dtype=bool)
        fixed[[self.dof(*where) for where in held]] = True
        K = compat.assemble_matrix(self.a, [], 1.0)
        K.zeroRowsColumns(np.flatnonzero(fixed).astype(np.int32), 1.0)
        return self.bodies, K, fixed


PIN = [((0.0, 0.0), 0), ((0.0, 0.0), 1)]
ROLLERS = [((0.0, 0.0), 1), ((1.0, 0.0), 1)]


@pytest.mark.parametrize(
    ("held", "spring", "free"),
    [
        ([], 0.0, 3),
        (PIN, 0.0, 1),  # turns about the pin
        (ROLLERS, 0.0, 1),  # slides
        ([*ROLLERS, ((0.0, 1.0), 1)], 0.0, 1),
        ([*PIN, ((1.0, 0.0), 0)], 0.0, 1),  # the third support points at the pin
        ([*PIN, ((1.0, 0.0), 1)], 0.0, 0),
        ([], 1.0, 0),
        ([], 1e-6, 0),
    ],
)
def test_one_square(held, spring, free):
    squares = Squares(spring=spring)  # which keeps the mesh
    parts = squares.parts(held)
    assert rigid_motions(*parts).free == free
    if free:
        with pytest.raises(llm.ContactError, match=rf"^{free} rigid motion\(s\) .*body 0"):
            check_support(rigid_motions(*parts), [])
    else:
        check_support(rigid_motions(*parts), [])


def test_motions_move_no_support():
    """Of two squares, one on a pin: it turns about the pin, the other one moves as it likes."""
    squares = Squares(count=2)
    bodies, K, fixed = squares.parts(PIN)
    rigid = rigid_motions(bodies, K, fixed)
    assert rigid.free == 4 and np.bincount(rigid.body).tolist() == [1, 3]
    modes = rigid.modes.toarray()
    assert not modes[fixed].any() and not rigid.stiffness.nnz
    arm = squares.x[bodies.label == 0]  # from the pin, at the origin
    turn = modes.reshape(-1, 2, 4)[bodies.label == 0, :, list(rigid.body).index(0)]
    assert np.abs(np.einsum("ni,ni->n", arm, turn)).max() < 1e-14
    assert np.allclose(
        np.linalg.norm(turn, axis=1), np.linalg.norm(arm, axis=1) * np.abs(turn).max()
    )


@pytest.mark.parametrize("spring", [0.0, 1e-6, 1.0])
def test_supports_leave_motions_whatever_springs_do(spring):
    squares = Squares(count=2, spring=spring)  # its communicator goes with it
    bodies, _, fixed = squares.parts([*PIN, ((1.0, 0.0), 1)])
    body, parts = left_by_supports(bodies, fixed)
    assert body.tolist() == [1, 1, 1] and np.linalg.matrix_rank(parts) == 3


@pytest.mark.parametrize("spring", [1e-4, 1e-8, 1e-12])
def test_weak_springs_are_motions_with_a_stiffness(spring):
    """On volume springs k the translations of a unit square have k each, the rotation about its
    middle k times its polar moment 1/6 over its size, half a diagonal, squared."""
    squares = Squares(spring=spring)
    rigid = rigid_motions(*squares.parts([]))
    assert rigid.free == 0
    stiffness = np.linalg.eigvalsh(rigid.stiffness.toarray())
    order = np.argsort(stiffness)
    known = np.array([1 / 3, 1.0, 1.0]) * spring
    found = stiffness[order]
    assert np.allclose(found, known, rtol=1e-12 + 1e-15 / spring)


@pytest.mark.parametrize(("components", "free"), [((0, 1), 0), ((0,), 2), ((1,), 1), ((), 3)])
def test_two_squares_at_two_points(components, free):
    """The second hangs on the first at two points, of the same height: both components, along the
    line through them (which two points feel twice), across, or not at all."""
    squares = Squares(count=2)
    held = [*PIN, ((1.0, 0.0), 1)]
    ties = [((1.0, 1.0), (2.0, 1.0)), ((0.0, 1.0), (3.0, 1.0))]
    bodies, K, fixed = squares.parts(held)
    modes = bodies.modes(bodies.label, bodies.points).reshape(len(fixed), -1)
    rows = [
        sign * modes[squares.dof(side, c)]
        for tie in ties
        for sign, side in zip((1.0, -1.0), tie)
        for c in components
    ]
    # One frame unknown for each pair of rows: both sides follow it.
    n = len(rows) // 2
    L = np.zeros((len(rows), n))
    k = len(components)
    for t in range(len(ties)):
        for i in range(k):
            L[2 * k * t + i, k * t + i] = 1.0
            L[2 * k * t + k + i, k * t + i] = -1.0
    interfaces = [(csr_matrix(L), csr_matrix(np.array(rows)))] if rows else []
    if free:
        with pytest.raises(llm.ContactError, match=rf"^{free} rigid motion\(s\) .*body 1"):
            check_support(rigid_motions(bodies, K, fixed), interfaces)
    else:
        check_support(rigid_motions(bodies, K, fixed), interfaces)
