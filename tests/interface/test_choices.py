"""What users choose from, laws and obstacles: wrong values are refused."""

import re

import numpy as np
import pytest

import dolfinx_llm as llm

pytestmark = pytest.mark.quick

WRONG = [
    (lambda: llm.Coulomb(-0.1), "mu=-0.1"),
    (lambda: llm.Coulomb(np.nan), "mu=nan"),
    (lambda: llm.Coulomb("0.3"), "mu='0.3'"),
    (lambda: llm.Coulomb(0.3, method="bisection"), "method='bisection'"),
    (lambda: llm.RigidPlane((0.0,), (0.0, 1.0)), "point=(0.0,): give 2 or 3 numbers"),
    (lambda: llm.RigidPlane("no", (0.0, 1.0)), "point='no': give"),
    (lambda: llm.RigidPlane((0.0, np.inf), (0.0, 1.0)), "must be finite"),
    (lambda: llm.RigidPlane((0.0, 0.0), (0.0, 0.0, 1.0)), "give 2 numbers"),
    (lambda: llm.RigidPlane((0.0, 0.0), (0.0, 0.0)), "has no direction"),
    (lambda: llm.RigidSphere((0.0, 0.0), 0.0), "radius=0.0"),
    (lambda: llm.RigidSphere((0.0, 0.0), (1.0, 2.0)), "radius=(1.0, 2.0)"),
    (lambda: llm.RigidCylinder((0.0, 0.0), (0.0, 0.0, 1.0), 1.0), "give 3 numbers"),
    (lambda: llm.RigidSurface("ramp.stl"), "mesh='ramp.stl'"),
    (lambda: llm.RigidPlane((0, 0), (0, 1), displacement=(1, 2, 3)), "displacement="),
    (lambda: llm.RigidPlane((0, 0), (0, 1), rotation=(0, 0, 1)), "rotation=(0, 0, 1): give the"),
    (lambda: llm.RigidPlane((0, 0, 0), (0, 0, 1), rotation=0.1), "rotation=0.1: give 3 numbers"),
    (lambda: llm.RigidPlane((0, 0), (0, 1), rotation=np.nan), "rotation=nan"),
    (lambda: llm.RigidPlane((0, 0), (0, 1), pivot=1.0), "pivot=1.0: give 2 numbers"),
    (lambda: llm.RigidPlane((0, 0), (0, 1), force=-10.0), "force=-10.0: give 2 entries"),
    (lambda: llm.RigidPlane((0, 0), (0, 1), force=(None, "down")), "force='down': give 2"),
    (lambda: llm.RigidSphere((0, 0), 1.0, force=(1, 2, 3)), "force=(1, 2, 3): give 2 entries"),
    (lambda: llm.RigidSphere((0, 0), 2.0).clearance(np.zeros((1, 2))), "1 surface node(s) lie at"),
    (lambda: llm.Interface(None, 3), "sides=3"),
    (lambda: llm.Interface(None, (3, 7), law="tied"), "law='tied'"),
    (lambda: llm.Interface(None, (3, 7), design="best"), "design='best'"),
    (lambda: llm.Interface(None, (3, 7), frame="coarse"), "frame='coarse'"),
]


@pytest.mark.parametrize("make, words", WRONG, ids=[words for _, words in WRONG])
def test_wrong_values_are_refused(make, words):
    with pytest.raises(llm.ContactInputError, match=re.escape(words)):
        make()


def test_two_obstacles_or_an_obstacle_with_a_frame_are_refused():
    plane = llm.RigidPlane((0.0, 0.0), (0.0, 1.0))
    frame = llm.Frame([[0.0, 0.0], [1.0, 0.0]], [[0, 1]])
    with pytest.raises(llm.ContactInputError, match="one must be a body"):
        llm.Interface(None, (plane, plane))
    with pytest.raises(llm.ContactInputError, match="leave frame=None"):
        llm.Interface(None, (3, plane), frame=frame)
