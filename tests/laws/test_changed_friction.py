"""What a law is given and changes between load steps: friction in gross slip, against μ N + c A."""

import numpy as np
import pytest
import ufl
from contact_scenes import BELOW, rectangle, stress
from dolfinx import fem
from mpi4py import MPI
from slider import PRESSED, Slider

import dolfinx_llm as llm
from dolfinx_llm import compat


def constant(value, **other):
    def law(domain):
        return llm.Coulomb(fem.Constant(domain, value), **other)

    return law


@pytest.mark.parametrize("rigid", [False, True])
@pytest.mark.parametrize("finite", [False, True])
def test_constants(finite, rigid):
    slider = Slider(constant(0.3), finite, rigid)
    first = slider.dragged()
    slider.law.mu.value = 0.1
    found = slider.dragged()
    # At finite deformation T and N are told by axes, not by the surface's normals.
    assert abs(first - 0.3) < (2e-3 if finite else 1e-9)
    assert abs(found - 0.1) < (2e-3 if finite else 1e-9)
    for side in slider.problem.results[0].sides:
        pressed = side.normal_force > 0.0
        normal = side.normal_force[:, None] * side.normal
        assert np.allclose((normal + side.tangential_force)[pressed], side.force[pressed])
        drag = np.linalg.norm(side.tangential_force, axis=1)
        assert abs(drag.sum() / side.normal_force.sum() - 0.1) < 1e-4


def test_arrays_and_functions():
    """Also from a friction of 0, which may be another one later."""
    nodes = np.zeros(5)  # of the frame
    slider = Slider(llm.Coulomb(nodes))
    assert slider.dragged() < 1e-9
    nodes[:] = 0.2
    assert abs(slider.dragged() - 0.2) < 1e-9
    way = [0.2]
    slider = Slider(llm.Coulomb(lambda x: np.full(len(x), way[0])))
    slider.dragged()
    way[0] = 0.4
    assert abs(slider.dragged() - 0.4) < 1e-9


def test_cohesion():
    bears = []
    slider = Slider(
        lambda domain: llm.Coulomb(0.0, cohesion=fem.Constant(domain, 1e-3)), rigid=True
    )
    for value in (1e-3, 3e-3):
        slider.law.cohesion.value = value
        slider.dragged()
        bears.append(abs(slider.problem.results[0].resultant[0]))
    np.testing.assert_allclose(bears, [2e-3, 6e-3], rtol=1e-9)  # of the area 2


@pytest.mark.parametrize("finite", [False, True])
def test_a_value_that_is_refused(finite):
    """The step is not begun; with a value that is right it goes on."""
    slider = Slider(constant(0.3), finite, rigid=True)
    slider.dragged()
    slider.law.mu.value = -0.1
    with pytest.raises(llm.ContactInputError, match="at least 0"):
        slider.dragged()
    slider.law.mu.value = 0.2
    assert abs(slider.dragged() - 0.2) < 2e-3


def test_another_value_in_a_state_that_is_read_or_carried_over(tmp_path):
    before = Slider(llm.Coulomb(0.3))
    before.dragged()
    before.problem.save(tmp_path / "state.npz")
    for cells in (4, 5):
        after = Slider(llm.Coulomb(0.1), cells=cells)
        if cells == 4:
            after.problem.load(tmp_path / "state.npz")
        else:
            llm.transfer(before.problem, after.problem)
        after.along = before.along
        assert abs(after.dragged() - 0.1) < 1e-9


def test_dynamic_friction_that_changes():
    """What slides has the dynamic coefficient of the moment, what has come to rest the other."""
    slider = Slider(lambda d: llm.Coulomb(0.4, dynamic=fem.Constant(d, 0.3)), rigid=True)
    assert abs(slider.dragged() - 0.4) < 1e-9
    assert abs(slider.dragged() - 0.3) < 1e-9
    slider.law.dynamic.value = 0.2
    assert abs(slider.dragged() - 0.2) < 1e-9


def test_steps_in_time():
    """A block that slides along a plane: friction is that of the moment."""
    domain, tags = rectangle(MPI.COMM_SELF, (4, 5), (0.0, 0.0), (1.0, 1.0), "quadrilateral")
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    mu = fem.Constant(domain, 0.4)
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    stepper = llm.TimeStepper(
        1.0,
        ufl.inner(stress(u), ufl.grad(w)) * ufl.dx,
        ufl.inner(fem.Constant(domain, np.array([0.0, -1.0])), w) * ufl.dx,
        dt=0.02,
        interfaces=[llm.Interface(tags, (BELOW, plane), law=llm.Coulomb(mu))],
    )
    stepper.v.x.array.reshape(-1, 2)[:] = 5.0, 0.0
    for value in (0.4, 0.1):
        mu.value = value
        stepper.step()
        T, N = np.abs(stepper.problem.results[0].resultant)
        assert N > 0.0 and abs(T / N - value) < 1e-9


class Layer(llm.Law):
    """A soft layer whose stiffness is read at the start of a step."""

    components, gives = "normal", True

    def __init__(self):
        self.k, self.read = 1e-4, 0

    def begin_step(self, nodes):
        self.read += 1
        return {"k": nodes.values(self.k)}

    def force(self, nodes):
        k = (nodes.given["k"] * nodes.area)[:, None]
        return k * nodes.jump, k


@pytest.mark.parametrize("finite", [False, True])
def test_laws_of_ones_own(finite):
    """Read once a step, however many iterations ask for forces; far softer than the block."""
    layer = Layer()
    slider = Slider(layer, finite, rigid=True)
    slider.along = -0.1  # pressed alone
    slider.dragged()
    before, layer.k, slider.along = layer.read, 3e-4, -0.1
    slider.dragged()
    assert layer.read == before + 1
    assert abs(slider.problem.results[0].resultant[1] / (-2.0 * PRESSED * layer.k) - 1.0) < 1e-2
