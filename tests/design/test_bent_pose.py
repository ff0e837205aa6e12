"""Rows between second-order bodies along surfaces that are curved both ways."""

import bent_rings
import numpy as np
from scipy.spatial.transform import Rotation

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.interface.build import build_interface


def bowl(Q):
    """Rows of both sides of a bowl in a bowl of second order, turned by Q, by the nodes' places."""
    spaces, sides = [], []
    for h, radii, tag in ((0.35, (0.6, 1.0), 1), (0.3, (1.0, 1.4), 3)):
        domain, tags = bent_rings.shell(h, *radii, tag)
        x = domain.geometry.x
        x[:] = (x * (1.0 - 0.3 * x[:, 2:] ** 2 * [1.0, 1.0, 0.0])) @ Q.T
        spaces.append(compat.function_space(domain, degree=2, shape=(3,)))
        sides.append((tags, 2 if tag == 1 else 3))
    geometry = build_interface(llm.Interface(None, sides, law=llm.Frictionless()), spaces)
    frame = np.lexsort((geometry.frame.x @ Q).round(7).T)
    order = [np.lexsort((pairs.x @ Q).round(7).T) for pairs in geometry.pairs]
    return [p.N[k][:, frame].toarray() for p, k in zip(geometry.pairs, order, strict=True)]


def test_rows_do_not_depend_on_the_pose():
    """What large multipliers are held with, and which stencils do, followed from the axes of the
    moments: rows differed by 0.14."""
    turn = Rotation.from_rotvec((0.7, -0.3, 1.1)).as_matrix()
    for one, other in zip(bowl(np.eye(3)), bowl(turn), strict=True):
        assert np.abs(one - other).max() < 1e-9
