"""Motions of interface nodes that are prescribed: any of them, on one side or on both."""

import itertools

import contact_scenes as cs
import numpy as np
import pairs
import pytest
import scenes
from mpi4py import MPI
from sampling import drawn

import dolfinx_llm as llm
from dolfinx_llm import compat

COMM = MPI.COMM_SELF
SHARE = 0.02  # uniaxial strain: the lateral motions vanish
LAWS = {"tied": llm.Tied(), "frictionless": llm.Frictionless(), "Coulomb": llm.Coulomb(0.3)}


def blocks(gdim, n=(4, 3)):
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
    sides = (made[0][1], cs.ABOVE), (made[1][1], cs.BELOW)
    interface = llm.Interface(None, sides, law=law, design=design)
    problem = scenes.elastic_problem(spaces, bcs, [interface])
    error = max(scenes.displacement_error(u, exact) for u in problem.solve())
    return problem, error


COMPONENTS = [c for n in range(4) for c in itertools.combinations(range(3), n)]
SIDES = [(0,), (1,), (0, 1)]


@pytest.mark.parametrize(
    ("law", "components", "sides", "gdim"),
    drawn(
        LAWS,
        COMPONENTS,
        SIDES,
        (2, 3),
        every=2,
        fits=lambda _, c, sides, gdim: max(c, default=0) < gdim,
    ),
)
def test_prescribed_components(law, components, sides, gdim):
    """Uniaxial strain is exact whatever is prescribed, and so is what presses."""
    problem, error = solved(gdim, LAWS[law], components, sides)
    assert error < 1e-11
    assert problem.geometries[0].certificate.residual < 1e-13
    pressure = problem.results[0].pressure
    assert np.ptp(pressure) < 1e-10 * pressure.max() > 0.0
    problem.destroy()


@pytest.mark.parametrize("law", LAWS)
def test_weights_in_2d(law):
    for components, sides in (((0,), (0, 1)), ((0,), (1,)), ((1,), (0,)), ((0, 1), (1,))):
        problem, error = solved(2, LAWS[law], components, sides, design="weights")
        assert error < 1e-11
        assert problem.geometries[0].certificate.residual < 1e-13


def test_normal_laws_ask_for_normal_motions_alone():
    """Lateral supports all over the interface leave a frictionless design as it is without."""
    one, _ = solved(3, llm.Frictionless(), (), ())
    two, _ = solved(3, llm.Frictionless(), (0, 1), (0, 1))
    for a, b in zip(one.geometries[0].pairs, two.geometries[0].pairs, strict=True):
        assert abs(a.N - b.N).max() < 1e-14


def test_rows_that_are_all_kept_are_said():
    """With nothing to correct the design cannot balance: a sentence, with the frame's nodes."""
    problem, _ = solved(3, llm.Tied(), (), (), design=None)
    geometry = problem.geometries[0]
    keep = [np.ones(len(p.nodes), dtype=bool) for p in geometry.pairs]
    N, forces = [p.N for p in geometry.pairs], [p.forces for p in geometry.pairs]
    cells = [p.cell for p in geometry.pairs]
    with pytest.raises(llm.ContactError, match="too little freedom"):
        llm.design_weights(geometry.frame, geometry.frame.x[:, :2], N, cells, forces, keep)
