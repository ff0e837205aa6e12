"""PETSc matrices by hand."""

import numpy as np
import pytest
from mpi4py import MPI
from scipy.sparse import csr_matrix

from dolfinx_llm.operators.petsc import create_aij, is_symmetric


@pytest.mark.parametrize("corner", [(0.5, 1.0), (0.5, 1e12), (1e6, 0.0), (1e6, 1e-12)])
def test_symmetry_is_that_of_every_row(corner):
    """One row of other units hides no asymmetry of the rest, nor one whose diagonal is none."""
    beside, large = corner
    A = np.array([[2.0, 1.0, 0.0], [1.0, 3.0, beside], [0.0, beside, large]])
    for off, expected in ((0.0, True), (1e-3, False)):
        A[0, 1] = 1.0 + off
        K = create_aij(MPI.COMM_SELF, (3, 3), (3, 3), csr_matrix(A))
        assert is_symmetric(K) is expected
        K.destroy()
