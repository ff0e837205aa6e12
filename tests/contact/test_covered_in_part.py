"""Second-order bodies along a curved surface of which the smaller one covers a part."""

import bent_rings
import numpy as np
import pytest
import scenes
from dolfinx import fem
from sampling import longer

import dolfinx_llm as llm
from dolfinx_llm import compat

LAWS = [llm.Coulomb(0.3), longer(llm.Frictionless()), longer(llm.Tied())]
FIRST, LAST = 0.2, 0.77  # of the quarter that the pad covers


def pressed(law, h):
    """Forces on a pad of cells of a size on a quarter of a drum, pressed and dragged, and the
    scene's problem."""
    drum = bent_rings.bricks(0.6 * h, 0.5, 1.0, 1, gdim=2)
    pad = bent_rings.bricks(h, 1.0, 1.3, 3, gdim=2)
    x = pad[0].geometry.x
    angle, r = np.arctan2(x[:, 1], x[:, 0]), np.hypot(x[:, 0], x[:, 1])
    angle = np.pi / 2 * FIRST + (LAST - FIRST) * angle
    x[:, :2] = r[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    spaces = [compat.function_space(domain, degree=2, shape=(2,)) for domain, _ in (drum, pad)]
    held = [fem.Function(V) for V in spaces]
    bcs = [
        fem.dirichletbc(f, fem.locate_dofs_topological(V, 1, tags.find(tag)))
        for f, V, (_, tags), tag in zip(held, spaces, (drum, pad), (1, 4), strict=True)
    ]
    interface = llm.Interface(None, ((drum[1], 2), (pad[1], 3)), law=law)
    problem = scenes.elastic_problem(spaces, bcs, [interface])
    found = []
    for way in ((-0.007, -0.007), (-0.003, -0.012)):
        held[1].x.array.reshape(-1, 2)[:] = way
        problem.solve()
        found.append(problem.results[0].resultant)
    return np.array(found), problem


@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_forces_are_those_of_finer_meshes(law):
    """Rows of nodes far beyond the frame's outline go on linearly. For polynomials of degree 2 they
    needed large corrections, and the coarser scene was refused."""
    (coarse, problem), (fine, other) = pressed(law, 0.1), pressed(law, 0.05)
    assert np.abs(coarse - fine).max() <= 0.01 * np.abs(fine).max()
    for side in problem.results[0].sides if law.opens else ():
        assert side.pressing.min() >= -1e-10 * side.pressing.max()
    for one in (problem, other):
        one.destroy()
