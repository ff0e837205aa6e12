"""Meshes that bodies may have; a stand-in has several kinds of cells, which newer dolfinx reads."""

from types import SimpleNamespace

import pytest
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm.geometry.spaces import check_space

pytestmark = pytest.mark.quick


@pytest.mark.parametrize(
    ("kinds", "said"),
    [
        (("hexahedron", "prism"), "hexahedron, prism: made for triangle"),
        (("tetrahedron", "hexahedron"), "hexahedron, tetrahedron: made for triangle"),
        (("pyramid",), "pyramid: made for"),
    ],
)
def test_cells_of_several_kinds_are_refused(kinds, said):
    cells = [SimpleNamespace(name=kind) for kind in kinds]
    topology = SimpleNamespace(dim=3, entity_types=[[], [], [], cells])
    geometry = SimpleNamespace(dim=3, cmaps=[SimpleNamespace(degree=1)] * len(kinds))
    mesh = SimpleNamespace(topology=topology, geometry=geometry, comm=MPI.COMM_SELF)
    V = SimpleNamespace(mesh=mesh, dofmap=None, element=None)
    with pytest.raises(llm.ContactInputError, match=said):
        check_space(V)
