"""Contact does not depend on how a scene is drawn: turned in space, or in other units."""

import bent_rings
import numpy as np
import pytest
import ufl
from dolfinx import fem
from sampling import longer
from scipy.spatial.transform import Rotation

import dolfinx_llm as llm
from dolfinx_llm import compat

TURN = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
PARTS = ((24, 0.3, 0.6, 0.1, 1, 1, 2), (16, 0.6, 1.0, 0.0, 1, 5, 3))


def pressed(law, turn, size, shift, angle):
    """A pin in a bore, hexahedra, moved aside and turned; iterations, and per side positions,
    forces and status, sorted by places in the drawing that is not turned."""
    heights = 0.4, 0.5
    meshes = [bent_rings.ring(*part, height=h) for part, h in zip(PARTS, heights, strict=True)]
    meshes[1][0].geometry.x[:, 2] -= 0.05
    spaces = []
    for domain, _ in meshes:
        domain.geometry.x[:] = size * domain.geometry.x @ turn.T
        spaces.append(compat.function_space(domain, degree=1, shape=(3,)))

    def moved(x):
        y = x.T / size @ turn
        w = 0.003 * y + np.outer(y[:, 0], [0, angle, 0]) - np.outer(y[:, 1], [angle, 0, 0])
        return ((w + [shift, 0.0, 0.001]) @ turn.T * size).T

    a, L, bcs = [], [], []
    for V, (_, tags), tag in zip(spaces, meshes, (1, 6), strict=True):
        known, (u, v) = fem.Function(V), (ufl.TrialFunction(V), ufl.TestFunction(V))
        if tag == 1:
            known.interpolate(moved)
        bcs.append(fem.dirichletbc(known, fem.locate_dofs_topological(V, 2, tags.find(tag))))
        eps = ufl.sym(ufl.grad(u))
        a.append(ufl.inner(eps + 0.75 * ufl.tr(eps) * ufl.Identity(3), ufl.grad(v)) * ufl.dx)
        L.append(ufl.inner(fem.Function(V), v) * ufl.dx)
    sides = ((meshes[0][1], 2), (meshes[1][1], 5))
    interface = llm.Interface(None, sides, law=law)
    problem = llm.ContactProblem(a, L, bcs=bcs, interfaces=[interface])
    problem.solve()
    found = []
    for side in problem.results[0].sides:
        order = np.lexsort((side.X / size @ turn).round(6).T + 0.0)
        found += [(side.force / size**2 @ turn)[order], side.status[order]]
    iterations = len(problem.history)
    problem.destroy()
    return iterations, found


@pytest.mark.parametrize(("shift", "angle"), [longer(0.002, 0.003), (0.0, 0.003)])
def test_pin_in_a_bore(shift, angle):
    """Nodes at the rim of contact slip as others do that are up to a quarter of the bore away."""
    law = llm.Coulomb(0.3)
    iterations, known = pressed(law, np.eye(3), 1.0, shift, angle)
    largest = max(np.abs(forces).max() for forces in known[::2])
    for turn, size in ((TURN, 1.0), (np.eye(3), 1e-3)):
        again, found = pressed(law, turn, size, shift, angle)
        assert again == iterations
        for was, now in zip(known, found, strict=True):
            assert np.abs(was - now).max() <= 1e-9 * largest
