"""Motions of interface nodes that are prescribed: any of them, on one side or on both."""

import itertools

import contact_scenes as cs
import numpy as np
import pairs
import pytest
import scenes
import ufl
from dolfinx import fem
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF
SHARE = 0.02  # uniaxial strain: the lateral motions vanish
LAWS = {"tied": llm.Tied(), "frictionless": llm.Frictionless(), "Coulomb": llm.Coulomb(0.3)}


def squeezed(p):
    out = 0.0 * p
    out[-1 if len(p) == 2 else 2] = -SHARE * p[-1 if len(p) == 2 else 2]
    return out


def blocks(gdim, n=(5, 4)):
    if gdim == 2:
        return [
            cs.rectangle(COMM, (k, 2), (0.0, z), (1.0, z + 1.0), "quadrilateral")
            for k, z in zip(n, (0.0, 1.0), strict=True)
        ]
    return [
        pairs.block(COMM, (k, k, 1), (0.0, 0.0, z), (1.0, 1.0, z + 1.0), "hexahedron")
        for k, z in zip(n, (0.0, 1.0), strict=True)
    ]


def solved(gdim, law, components, sides, design="auto"):
    """Two blocks in uniaxial strain; on the interface's nodes of these sides these components of
    the displacement are prescribed.

    Returns:
        The problem and the largest error of the displacement over the largest displacement.
    """
    made = blocks(gdim)
    spaces = [compat.function_space(d, shape=(gdim,)) for d, _ in made]

    def exact(p):
        out = np.zeros((gdim, p.shape[1]))
        out[-1] = -SHARE * p[gdim - 1]
        return out

    bcs = []
    for side, V in enumerate(spaces):
        planes = [(k, scenes.on(k, at)) for k in range(gdim - 1) for at in (0.0, 1.0)]
        planes += [(gdim - 1, scenes.on(gdim - 1, (0.0, 2.0)[side]))]
        if side in sides:
            planes += [(k, scenes.on(gdim - 1, 1.0)) for k in components]
        bcs += scenes.hold(V, planes, exact)
    forms = [(ufl.TrialFunction(V), ufl.TestFunction(V)) for V in spaces]
    problem = llm.ContactProblem(
        [ufl.inner(cs.stress(u), ufl.grad(w)) * ufl.dx for u, w in forms],
        [
            ufl.inner(fem.Constant(V.mesh, np.zeros(gdim)), w) * ufl.dx
            for V, (_, w) in zip(spaces, forms, strict=True)
        ],
        bcs=bcs,
        interfaces=[
            llm.Interface(None, ((made[0][1], cs.ABOVE), (made[1][1], cs.BELOW)), law=law,
                          design=design)
        ],
    )  # fmt: skip
    error = max(scenes.displacement_error(u, exact) for u in problem.solve())
    return problem, error


CASES = [
    (gdim, components, sides)
    for gdim in (2, 3)
    for n in range(gdim + 1)
    for components in itertools.combinations(range(gdim), n)
    for sides in (((0,), (1,), (0, 1)) if n else ((),))
]
