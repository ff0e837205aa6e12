"""What springs carry while contact is being found: much ends a load step, little another form may
tell better."""

from types import SimpleNamespace

import numpy as np
import pytest
import scenes
import ufl
from dolfinx import fem, mesh
from facing_scenes import tagged
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.forms.floating import Pull
from dolfinx_llm.forms.verdict import FinalError

pytestmark = pytest.mark.quick


def of_one_motion(load, before):
    """Of a body of one motion under a load, the last step of which ended with a force."""
    rigid, sizes = SimpleNamespace(describe=lambda *told: "body 0"), np.array([load])
    of_one = {"count": 1, "square": np.eye(1), "grip": np.zeros((0, 1)), "rigid": rigid}
    floating = SimpleNamespace(**of_one, sizes=lambda f: sizes)
    return Pull(floating, 1.0, np.zeros(0), (0.0, before), np.zeros(1))


@pytest.mark.parametrize(("share", "final"), [(1e-6, False), (1e-2, True)])
def test_what_is_left_of_a_load(share, final):
    """A band on a drum, both ends of which are pulled alike: all but some nodes slip, and with all
    of them slipping 1e-8 to 1e-6 of the forces is left; it was told to be pulled off for good."""
    pull = of_one_motion(load=1.0, before=100.0)
    with pytest.raises(ContactError, match=f"{share:.1e} of the forces is left") as raised:
        for _ in range(20):
            pull.watch(pull.anchor + share, np.zeros(0), 2, 0.0)
    assert isinstance(raised.value, FinalError) == final


@pytest.mark.parametrize(("pulls", "rests"), [(1e-9, True), (1e-5, False)])
def test_what_is_left_without_load(pulls, rests):
    """Next to nothing of what there was is nothing; it was taken for all that there is."""
    pull = of_one_motion(load=1e-15, before=1.0)
    pull.watch(np.array([pulls]), np.zeros(0), 2, 0.0)
    assert pull.rests == rests
    pull = of_one_motion(load=1e-3, before=1.0)
    pull.watch(np.array([1e-9]), np.zeros(0), 2, 0.0)
    assert not pull.rests


def test_a_plug_released(caplog):
    """A plug between slopes on which it does not lock, after a large load: the form was given up,
    and in a cone all of them were."""
    angle, mu = np.deg2rad(10.0), 0.15
    domain = mesh.create_rectangle(
        MPI.COMM_SELF, [[0.0, 0.0], [1.0, 1.0]], [16, 16], mesh.CellType.quadrilateral
    )
    sides = [
        mesh.locate_entities_boundary(domain, 1, lambda p, k=k, at=at: np.isclose(p[k], at))
        for k, at in ((0, 0.0), (0, 1.0), (1, 1.0))
    ]
    tags = tagged(domain, sides)
    x = domain.geometry.x
    x[:, 0] = (x[:, 0] - 0.5) * (1.0 + 2.0 * np.tan(angle) * x[:, 1])
    V = compat.function_space(domain, shape=(2,))
    a, _ = scenes.forms(V, 1e5)
    load, ds = fem.Constant(domain, 0.0), ufl.Measure("ds", domain, subdomain_data=tags)
    c, s = np.cos(angle), np.sin(angle)
    interfaces = [
        llm.Interface(
            tags, (tag, llm.RigidPlane((-0.5 * way, 0.0), (c * way, s))), law=llm.Coulomb(mu)
        )
        for tag, way in ((1, 1.0), (2, -1.0))
    ]
    problem = llm.ContactProblem(a, load * ufl.TestFunction(V)[1] * ds(3), interfaces=interfaces)
    for now in (150.0, 300.0, 180.0, 90.0, 30.0, 9.0, 0.0):
        load.value = -now / (1.0 + 2.0 * np.tan(angle))
        problem.solve()
    assert max(np.abs(result.resultant).max() for result in problem.results) <= 1e-9
    assert "no rest" not in caplog.text
