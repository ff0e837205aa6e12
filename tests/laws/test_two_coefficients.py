"""Static and dynamic friction of a block that a spring pulls, against values by hand."""

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

STATIC, DYNAMIC, SPEED = 0.5, 0.3, 0.1


class Pulled:
    """Block of weight and mass 1, as good as rigid, whose base a spring of stiffness 1 pulls along
    a plane; one cell wide, so that all of the base slips at once."""

    def __init__(self):
        corners, cells = [[0.0, 0.0], [1.0, 1.0]], [1, 4]
        domain = mesh.create_rectangle(MPI.COMM_SELF, corners, cells, mesh.CellType.quadrilateral)
        base = mesh.locate_entities_boundary(domain, 1, lambda x: np.isclose(x[1], 0.0))
        self.tags = mesh.meshtags(domain, 1, base, np.full(len(base), 1, dtype=np.int32))
        V = compat.function_space(domain, shape=(2,))
        u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
        ds = ufl.Measure("ds", domain=domain, subdomain_data=self.tags)(1)
        self.end = fem.Constant(domain, 0.0)
        eps, delta = ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(w))
        self.a = 1e4 * ufl.inner(eps, delta) * ufl.dx + u[0] * w[0] * ds
        self.L = self.end * w[0] * ds - w[1] * ufl.dx

    def interface(self):
        plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
        law = llm.Coulomb(STATIC, dynamic=DYNAMIC)
        return llm.Interface(self.tags, (1, plane), law=law)


def test_load_steps():
    """It sticks, slips at the static limit, from the next step on at the dynamic one; where it has
    come to rest the static one holds again."""
    pulled = Pulled()
    problem = llm.ContactProblem(pulled.a, pulled.L, interfaces=pulled.interface())
    ways = 0.4, 0.6, 0.6, 0.55, 0.75, 0.85
    found = []
    for way in ways:
        pulled.end.value = way
        problem.solve()
        found.append(abs(problem.results[0].resultant[0]))
    # at rest from the third step on, which leaves the base at 0.3
    np.testing.assert_allclose(found, [0.4, 0.5, 0.3, 0.25, 0.45, 0.5], atol=1e-9)


@pytest.mark.long
def test_stick_slip():
    """Times at which it breaks loose and comes to rest, friction meanwhile, and the spring's force
    then, 2 μ_d - μ_s of the weight."""
    pulled, dt = Pulled(), 0.06
    rest = llm.ContactProblem(pulled.a, pulled.L, interfaces=pulled.interface())
    s = llm.TimeStepper(1.0, pulled.a, pulled.L, dt=dt, interfaces=pulled.interface())
    s.u.x.array[:] = rest.solve().x.array
    base = np.isclose(s.u.function_space.tabulate_dof_coordinates()[:, 1], 0.0)
    rows = []
    while len(rows) < 2 or rows[-1][1] or not rows[-2][1]:
        pulled.end.value = SPEED * (s.t + dt)
        s.step()
        side = s.problem.results[0].sides[0]
        friction = abs(s.problem.results[0].resultant[0])
        pull = pulled.end.value - s.u.x.array.reshape(-1, 2)[base, 0].mean()
        rows.append([s.t, (side.status == 2).any(), friction, float(pull)])
        assert s.t < 11.0
    t, slips, friction, pull = np.array(rows).T
    slips = slips.astype(bool)
    first, drop = STATIC / SPEED, STATIC - DYNAMIC
    lasts = 2.0 * (np.pi - np.arctan(drop / SPEED))
    assert abs(t[slips][0] - first) <= 1.5 * dt
    assert abs(t[slips][-1] - t[slips][0] - lasts) <= 2.0 * dt
    np.testing.assert_allclose(friction[~slips][:-1], SPEED * t[~slips][:-1], atol=2e-3)
    np.testing.assert_allclose(friction[slips], [STATIC] + [DYNAMIC] * (slips.sum() - 1), atol=1e-6)
    assert abs(pull[slips][-1] - (2.0 * DYNAMIC - STATIC)) <= 0.02


def test_refused():
    with pytest.raises(llm.ContactInputError, match="dynamic=-0.1"):
        llm.Coulomb(0.3, dynamic=-0.1)
    pulled = Pulled()
    interface = llm.Interface(
        pulled.tags,
        (1, llm.RigidPlane((0.0, 0.0), (0.0, 1.0))),
        law=llm.Coulomb(0.3, dynamic=0.4),
    )
    with pytest.raises(llm.ContactInputError, match="dynamic is above mu, by 0.1"):
        llm.ContactProblem(pulled.a, pulled.L, interfaces=interface).solve()
    V = pulled.a.arguments()[0].ufl_function_space()
    u = fem.Function(V)
    F = ufl.action(pulled.a, u) - pulled.L
    with pytest.raises(llm.ContactInputError, match="dynamic"):
        llm.NonlinearContactProblem(F, u, interfaces=pulled.interface())
