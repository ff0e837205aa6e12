"""Meshes that bodies may have, and Functions on them; a stand-in has several kinds of cells, which
newer dolfinx reads."""

from types import SimpleNamespace

import pytest
import sampled
from conftest import run_mpi_json
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


def test_functions_at_nodes_of_surfaces():
    """Continuous ones are what they are; where a node's cells differ it is the mean of those that
    have a facet there, whatever the order of cells and the number of ranks."""
    for found in (sampled.errors(MPI.COMM_SELF), run_mpi_json("sampled.py", 3)):
        assert max(found.values()) < 1e-12, found
