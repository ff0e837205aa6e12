"""Node-to-segment multipliers (2)-(6) and the elimination of the frame (32)-(36)."""

import json

import numpy as np
import patch3d
import pytest
from conftest import run_mpi_json
from dolfinx import fem
from mpi4py import MPI
from paper_data import PRESSURE, scene

from dolfinx_llm import ContactError, ContactInputError, compat, post
from dolfinx_llm.problem.classical import Elimination, NodeToSegment

SIDES = {"foundation": 0, "punch": 1}


def von_mises_error(u) -> float:
    domain = u.function_space.mesh
    values = post.at_quadrature_points(post.von_mises(patch3d.stress(u)), domain)
    return domain.comm.allreduce(np.abs(values / PRESSURE - 1.0).max(initial=0.0), op=MPI.MAX)


def relative(a, b) -> float:
    return float(np.abs(a - b).max() / np.abs(b).max())


def differences(contact, u) -> dict:
    """Of (36) against (31), relative; the same on every rank."""
    result = contact.results[0]
    form = Elimination(contact)
    w, comm = form.solve(), contact.comm
    largest = comm.allreduce(np.abs(u.x.array).max(initial=0.0), op=MPI.MAX)
    gap = comm.allreduce(np.abs(w.x.array - u.x.array).max(initial=0.0), op=MPI.MAX)
    return {
        "u": float(gap / largest),
        "multiplier": relative(form.force, np.concatenate([s.force for s in result.sides])),
        "v": relative(form.v, result.frame.v),
        "von_mises": float(von_mises_error(w)),
        "node_fill": form.stats.node_fill,
        "residual": form.residual,
        "classical": [
            float(von_mises_error(NodeToSegment(contact, slave=k).solve())) for k in (0, 1)
        ],
    }


def build(comm):
    domain, tags = scene(comm)
    contact = patch3d.problem(compat.function_space(domain, shape=(3,)), tags, "predicted")
    return contact, contact.solve()


@pytest.fixture(scope="module")
def contact_and_u():
    return build(MPI.COMM_SELF)


@pytest.fixture(scope="module")
def elimination(contact_and_u):
    form = Elimination(contact_and_u[0])
    form.solve()
    return form


def assert_equivalent(found: dict):
    print(found)
    assert found["u"] < 1e-11
    assert found["multiplier"] < 1e-11
    assert found["v"] < 1e-11
    assert found["von_mises"] < 1e-12
    assert found["residual"] < 1e-12


def test_elimination_is_the_frame_form(contact_and_u):
    assert_equivalent(differences(*contact_and_u))


@pytest.mark.long
def test_two_ranks(contact_and_u):
    found = run_mpi_json(__file__, 2)
    assert_equivalent(found)
    alone = differences(*contact_and_u)
    assert found["classical"] == pytest.approx(alone["classical"], rel=1e-9)
    assert found["node_fill"] == pytest.approx(alone["node_fill"], abs=1.0)


def test_projector_and_basis(contact_and_u, elimination):
    contact, _ = contact_and_u
    L = contact.operators.blocks[0].toarray()
    P, Phi = elimination.P, elimination.Phi
    n, m = L.shape
    assert Phi.shape == (n, n - m)
    assert np.abs(P - (np.eye(n) - L @ np.linalg.solve(L.T @ L, L.T))).max() < 1e-12  # (32)
    assert np.abs(P @ P - P).max() < 1e-13
    assert np.abs(P - P.T).max() < 1e-13
    assert np.abs(P @ L).max() < 1e-13
    assert np.abs(Phi.T @ Phi - np.eye(n - m)).max() < 1e-13
    assert np.abs(P @ Phi - Phi).max() < 1e-13
    assert np.linalg.matrix_rank(np.hstack([Phi, L])) == n  # (35)


def test_operator_of_the_elimination(contact_and_u, elimination):
    contact, _ = contact_and_u
    B = contact.B.convert("dense").getDenseArray().copy()
    Q = elimination.Q.convert("dense").getDenseArray().copy()
    number = contact.operators.rows.numbering.number
    assert np.abs(Q.T - B[:, number] @ elimination.P @ elimination.Phi).max() < 1e-14


def test_frame_form_is_dense_and_the_classical_one_sparse(contact_and_u, elimination):
    contact, _ = contact_and_u
    print("\nelimination", elimination.stats)
    assert elimination.stats.node_fill > 50.0
    assert elimination.stats.fill > 100.0 / 3.0 / 2.0  # the three directions do not couple
    for name, slave in SIDES.items():
        stats = NodeToSegment(contact, slave=slave).stats
        print(name, stats)
        assert stats.node_fill < 15.0
        assert stats.fill < 5.0


@pytest.mark.parametrize("slave", SIDES.values(), ids=SIDES)
def test_classical_form_fails_the_patch_test(contact_and_u, slave):
    contact, u = contact_and_u
    form = NodeToSegment(contact, slave=slave)
    error = von_mises_error(form.solve())
    print(f"\nvon Mises error {100 * error:.1f} %")
    assert error > 0.01
    assert von_mises_error(u) < 1e-12
    # The resultant passes all the same: pressure on the punch, upwards on the punch.
    area = contact.geometries[0].area
    up = PRESSURE * area * (1.0 if slave else -1.0)
    assert np.allclose(form.force.sum(axis=0), [0.0, 0.0, up], atol=1e-9 * abs(up))


@pytest.mark.parametrize("slave", SIDES.values(), ids=SIDES)
def test_constraints_pass_linear_fields(contact_and_u, slave):
    """Flat facets reproduce them: Q u = a_i · (A X_m - A X_s) = 0 where the surfaces coincide."""
    contact, _ = contact_and_u
    form = NodeToSegment(contact, slave=slave)
    x = contact.spaces[0].tabulate_dof_coordinates()
    x = x[: len(contact.bulk.dofs.fixed) // 3]
    u, out = form.Q.createVecs()
    u.array_w[:] = (x @ np.random.default_rng(36).standard_normal((3, 3)) + [1.0, 2.0, 3.0]).ravel()
    form.Q.mult(u, out)
    assert np.abs(out.array_r).max() < 1e-12
    assert len(out.array_r) == 3 * len(form.x)
    # The slave nodes are those inside the 14-gon (foundation) or all in contact (punch).
    assert len(form.x) == (32 if slave else 21)


def test_solution_against_a_dense_oracle(contact_and_u):
    """(6) in NumPy."""
    contact, _ = contact_and_u
    form = NodeToSegment(contact, slave=1)
    u = form.solve()
    K, Q = (M.convert("dense").getDenseArray().copy() for M in (contact.K, form.Q))
    c = len(Q)
    A = np.block([[K, contact.scale * Q.T], [contact.scale * Q, np.zeros((c, c))]])
    found = np.linalg.solve(A, np.concatenate([contact.bulk.load(), np.zeros(c)]))
    assert relative(u.x.array, found[:-c]) < 1e-10
    assert relative(form.multiplier.ravel(), contact.scale * found[-c:]) < 1e-10


def test_prescribed_surface_dofs(monkeypatch):
    """Prescribed values enter g: a motion prescribed along y on y = 0 only shifts the solution."""
    found = []
    for shift in (0.0, 0.02):
        monkeypatch.setattr(patch3d, "supports", lambda V, shift=shift: shifted_supports(V, shift))
        contact, u = build(MPI.COMM_SELF)
        forms = [NodeToSegment(contact, slave=0), NodeToSegment(contact, slave=1)]
        elimination, result = Elimination(contact), contact.results[0]
        solutions = [u, elimination.solve(), *(form.solve() for form in forms)]
        found.append([w.x.array.reshape(-1, 3) for w in solutions])
        force = np.concatenate([side.force for side in result.sides])
        assert relative(elimination.force, force) < 1e-10
        assert relative(elimination.v, result.frame.v) < 1e-10
        # Constraints between prescribed dofs alone, along y at y = 0, are left out.
        on_axis = [int((np.abs(form.x[:, 1]) < 1e-9).sum()) for form in forms]
        lost = [3 * len(form.x) - form.stats.constraints for form in forms]
        assert lost == on_axis
        assert min(lost) > 0
    assert relative(found[0][1], found[0][0]) < 1e-11
    for before, after in zip(*found, strict=True):
        assert np.abs(after - before - [0.0, 0.02, 0.0]).max() < 1e-12


def shifted_supports(V, shift):
    """The paper's, but u_y = shift wherever y = 0, on both bodies."""
    conditions = []
    for k, where in (
        (2, lambda p: np.isclose(p[2], 0.0)),
        (0, lambda p: np.isclose(p[2], 0.0) & np.isclose(p[0], 0.0)),
        (1, lambda p: np.isclose(p[1], 0.0)),
    ):
        Vk, _ = V.sub(k).collapse()
        value = fem.Function(Vk)
        value.x.array[:] = shift if k == 1 else 0.0
        dofs = fem.locate_dofs_geometrical((V.sub(k), Vk), where)
        conditions.append(fem.dirichletbc(value, dofs, V.sub(k)))
    return conditions


def test_normal_constraints_leave_the_punch_free(contact_and_u):
    with pytest.raises(ContactError, match="3 rigid motion"):
        NodeToSegment(contact_and_u[0], slave=1, components="normal")


def test_arguments(contact_and_u, monkeypatch):
    contact, _ = contact_and_u
    with pytest.raises(ContactInputError, match="slave=2"):
        NodeToSegment(contact, slave=2)
    with pytest.raises(ContactInputError, match="components='z'"):
        NodeToSegment(contact, slave=0, components="z")
    monkeypatch.setattr("dolfinx_llm.problem.classical.elimination.MAX_ROWS", 230)
    with pytest.raises(ContactInputError, match="231 multipliers"):
        Elimination(contact)


def main():
    found = differences(*build(MPI.COMM_WORLD))
    if MPI.COMM_WORLD.rank == 0:
        print(json.dumps(found))


if __name__ == "__main__":
    main()
