"""Bodies on submeshes of one mesh, with Functions and integrals of both (entity_maps)."""

import gmsh
import numpy as np
import pytest
import ufl
from conftest import run_mpi_json
from dolfinx import mesh
from mpi4py import MPI
from scenes import E
from submeshes import MAPPED, Halves

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.geometry.spaces import check_space
from dolfinx_llm.interface.build import build_interface


def displacements(problem):
    """Of a load step."""
    return np.concatenate([u.x.array for u in problem.solve()])


@pytest.mark.skipif(not MAPPED, reason="this dolfinx has no entity maps")
@pytest.mark.parametrize("nonlinear", [False, True])
def test_forms_of_two_meshes(nonlinear):
    """Functions of the parent, and integrals over it, give what Functions of the submesh give; a
    modulus that changes there is noticed."""
    own, scenes = Halves("own", nonlinear), [Halves(w, nonlinear) for w in ("both", "parent")]
    expected = displacements(own.problem())
    assert np.abs(expected).max() > 0.01
    problems = [scene.problem() for scene in scenes]
    for problem in problems:
        np.testing.assert_allclose(displacements(problem), expected, atol=1e-11)
    for scene in (own, *scenes):
        for modulus in scene.moduli:
            modulus.x.array[:] = E * (4.0 - modulus.x.array / E)
        for u in scene.u:
            u.x.array[:] = 0.0
    softer = displacements(own.problem())
    assert np.abs(softer - expected).max() > 1e-3
    for problem in problems:
        problem.reset()
        np.testing.assert_allclose(displacements(problem), softer, atol=1e-11)


@pytest.mark.skipif(not MAPPED, reason="this dolfinx has no entity maps")
def test_adjoint_of_two_meshes():
    """Of a functional with the parent's modulus, as with one of the submesh."""
    found = []
    for where in ("own", "both"):
        scene = Halves(where)
        problem = scene.problem()
        moduli = scene.moduli * (2 if where == "both" else 1)
        dJ = [
            ufl.derivative(m * (u[0] + u[1] ** 2) * ufl.dx(V.mesh), u, ufl.TestFunction(V))
            for u, V, m in zip(problem.solve(), problem.spaces, moduli, strict=True)
        ]
        found.append(np.concatenate([p.x.array for p in problem.adjoint(dJ)]))
    np.testing.assert_allclose(*found, rtol=0.0, atol=1e-10 * np.abs(found[0]).max())
    assert np.abs(found[0]).max() > 0.0


@pytest.mark.skipif(not MAPPED, reason="this dolfinx has no entity maps")
@pytest.mark.long
@pytest.mark.parametrize("nonlinear", [False, True])
def test_steps_in_time_of_two_meshes(nonlinear):
    """What is compiled for steps in time, and later, knows the maps as well."""
    found = []
    for where in ("own", "both"):
        scene = Halves(where, nonlinear)
        stepper = llm.TimeStepper(
            1.0, scene.forms, scene.u if nonlinear else scene.loads, dt=1e-3, scheme="newmark",
            bcs=scene.bcs, interfaces=scene.interface, entity_maps=scene.entity_maps,
        )  # fmt: skip
        stepper.step()
        found.append(np.concatenate([u.x.array for u in stepper.u]))
    np.testing.assert_allclose(*found, atol=1e-11)


@pytest.mark.skipif(MAPPED, reason="this dolfinx has entity maps")
def test_entity_maps_are_refused_where_there_are_none():
    scene = Halves("own")
    scene.entity_maps = {}
    with pytest.raises(llm.ContactInputError, match="has none, 0.8 and newer have: interpolate"):
        scene.problem()


@pytest.mark.skipif(not MAPPED, reason="this dolfinx has no entity maps")
@pytest.mark.parametrize("wrong", [3, "maps", [3], {"mesh": 3}.items()])
def test_other_maps_are_refused(wrong):
    scene = Halves("both")
    scene.entity_maps = wrong
    with pytest.raises(llm.ContactInputError, match="entity_maps=.*: does not fit: give a "):
        scene.problem()
    scene.entity_maps = None
    with pytest.raises(llm.ContactInputError, match="several meshes.*entity_maps"):
        scene.problem()


@pytest.mark.long
def test_on_ranks():
    """Rigid ends under moments, prescribed means and submeshes: two ranks say what one does."""
    one, two = (run_mpi_json("front_door.py", ranks) for ranks in (1, 2))
    assert one.keys() == two.keys() and len(one) == (4 if MAPPED else 2)
    for name, values in one.items():
        np.testing.assert_allclose(two[name], values, rtol=1e-9, atol=1e-11, err_msg=name)
    assert one["moment"][2:5] == pytest.approx([-0.3, 2.0, -0.7], rel=1e-9)
    assert one["mean"][:2] == pytest.approx([0.02, -0.01], rel=1e-9)


def test_submeshes_that_have_lost_nodes():
    """Of a second-order mesh dolfinx 0.5.2 keeps the corners alone: refused, or all are there."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    face = gmsh.model.occ.addRectangle(0, 0, 0, 1, 1)
    gmsh.model.occ.synchronize()
    gmsh.model.addPhysicalGroup(2, [face], 1)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
    gmsh.model.mesh.generate(2)
    gmsh.model.mesh.setOrder(2)
    domain, _, _ = compat.model_to_mesh(gmsh.model, MPI.COMM_SELF, 0, gdim=2)
    gmsh.finalize()
    cells = np.arange(domain.topology.index_map(2).size_local, dtype=np.int32)
    sub = mesh.create_submesh(domain, 2, cells)[0]
    V = compat.function_space(sub, degree=2, shape=(2,))
    facets = mesh.locate_entities_boundary(sub, 1, lambda x: np.isclose(x[1], 1.0))
    tags = mesh.meshtags(sub, 1, facets, np.full(len(facets), 3, dtype=np.int32))
    interface = llm.Interface(tags, (3, llm.RigidPlane((0.0, 1.0), (0.0, -1.0))))
    if compat.cell_dofs(sub.geometry).shape[1] < 6:
        with pytest.raises(llm.ContactInputError, match="3 of 6 nodes"):
            build_interface(interface, [check_space(V, 2) or V])
    else:
        surface = build_interface(interface, [V]).pairs[0].surface
        assert np.allclose(surface.x[:, 1], 1.0) and len(surface.x) == 2 * len(facets) + 1
