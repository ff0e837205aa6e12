"""A surface of bodies that gmsh has fragmented, opened by its Crack plugin as in messages.md."""

import gmsh
import numpy as np
import pytest
import scenes
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat

SURFACE, RIM = 3, 4


def opened(rim):
    """Two squares, one on the other."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ, group = gmsh.model.occ, gmsh.model.addPhysicalGroup
    for k in (0, 1):
        occ.addRectangle(0.0, k, 0.0, 1.0, 1.0, k + 1)
    occ.fragment([(2, 1)], [(2, 2)])
    occ.synchronize()
    (curve,) = (c for _, c in gmsh.model.getEntities(1) if occ.getCenterOfMass(1, c)[1] == 1.0)
    group(2, [1, 2], 1), group(1, [curve], SURFACE)
    group(0, [p for _, p in gmsh.model.getBoundary([(1, curve)], oriented=False)], RIM)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
    gmsh.model.mesh.generate(2)
    options = {"Dimension": 1, "PhysicalGroup": SURFACE, "OpenBoundaryPhysicalGroup": rim}
    for name, value in options.items():
        gmsh.plugin.setNumber("Crack", name, value)
    gmsh.plugin.run("Crack")
    gmsh.model.mesh.renumberNodes()
    mesh, _, tags = compat.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=2)
    gmsh.finalize()
    return compat.function_space(mesh, shape=(2,)), tags


def test_along_the_rim_as_well():
    V, tags = opened(RIM)
    with pytest.raises(llm.ContactError, match="which llm.find_interfaces tells apart"):
        scenes.elastic_problem([V], [], [llm.Interface(tags, (SURFACE, SURFACE))])
    found = llm.find_interfaces(None, V, law=llm.Frictionless())
    ends = [(0, scenes.on(0, 0.0)), (1, scenes.on(1, 0.0)), (1, scenes.on(1, 2.0))]
    bcs = scenes.hold(V, ends, lambda p: np.outer([0.0, -0.01], p[1]))
    problem = scenes.elastic_problem([V], bcs, found)
    problem.solve()
    stress = scenes.E * 0.01 / (1.0 - scenes.NU**2)
    assert problem.results[0].pressure == pytest.approx(stress, rel=1e-10)


def test_joined_at_the_rim():
    V, _ = opened(0)
    with pytest.raises(llm.ContactError, match="must not share any node.*OpenBoundary"):
        llm.find_interfaces(None, V)
