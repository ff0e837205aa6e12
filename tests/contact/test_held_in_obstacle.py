"""Supports that hold nodes of a body inside of an obstacle: no force of contact moves these."""

import numpy as np
import pytest
import scenes
from dolfinx import mesh
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

LEFT, BOTTOM = scenes.on(0, 0.0), scenes.on(1, 0.0)
STEPS = (0.0, 0.003, 0.02, 0.0, 0.02)


@pytest.mark.parametrize("solver", ["saddle", "condensed"])
@pytest.mark.parametrize("law", [llm.Frictionless(), llm.Coulomb(0.3)], ids=["free", "friction"])
@pytest.mark.parametrize(("held", "order"), [(LEFT, 1), (LEFT, 2), (BOTTOM, 1)])
def test_supports_bear_all_there(held, order, law, solver, caplog):
    """A block held along one side, and a floor that goes up below it. By how far it went the solve
    failed, with forces of 1e19 on the way, or a node in the floor was told to touch it."""
    domain = mesh.create_rectangle(MPI.COMM_WORLD, ((0.0, 0.0), (2.0, 1.0)), (7, 4))
    facets = mesh.locate_entities_boundary(domain, 1, BOTTOM)
    tags = scenes.tags_from(domain, [facets], [np.full(len(facets), 1)], 1)
    V = compat.function_space(domain, degree=order, shape=(2,))
    floor, bcs = llm.RigidPlane((0.0, 0.0), (0.0, 1.0)), scenes.hold(V, [(0, held), (1, held)])
    interface = llm.Interface(tags, (1, floor), law=law)
    problem = scenes.elastic_problem([V], bcs, [interface], solver=solver)
    found, told = {}, list[bool]()
    for up in STEPS:
        floor.displacement = (0.0, up)
        caplog.clear()
        problem.solve()
        told.append("supports hold nodes in the obstacle, by up to" in caplog.text)
        assert told[-1] == bool(caplog.records)
        (result,) = problem.results
        (side,) = result.sides
        there = held(side.x.T)
        if order == 1:  # of second order this holds for control values
            assert not side.force[there].any()
            assert ((side.x + side.u)[~there, 1] > up - 1e-12).all()
            assert (side.normal_force > -1e-12 * scenes.E).all()
        found.setdefault(up, []).append(result.resultant[1])
    assert told == [False, True, False, False, True]  # once for as long as it is so
    assert np.allclose(found[0.0], 0.0, atol=1e-9 * abs(found[0.02][0]))
    if law.opens and not law.slips or held is BOTTOM:  # forces are in proportion to the motion
        at_last = np.array(found[0.02])
        assert np.allclose(at_last / 0.02, found[0.003][0] / 0.003, rtol=1e-8)
    assert (found[0.02][0] == 0.0) if held is BOTTOM else (found[0.02][0] < -1e-3 * scenes.E)
    problem.destroy()
