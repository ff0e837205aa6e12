"""PETSc matrices by hand."""

import numpy as np
import pytest
from mpi4py import MPI
from scipy.sparse import csr_matrix

from dolfinx_llm.operators.petsc import create_aij, is_symmetric


@pytest.mark.parametrize("large", [1.0, 1e12])
def test_symmetry_is_that_of_every_row(large):
    """One row of other units hides no asymmetry of the rest."""
    A = np.array([[2.0, 1.0, 0.0], [1.0, 3.0, 0.5], [0.0, 0.5, large]])
    for off, expected in ((0.0, True), (1e-3, False)):
        A[0, 1] = 1.0 + off
        K = create_aij(MPI.COMM_SELF, (3, 3), (3, 3), csr_matrix(A))
        assert is_symmetric(K) is expected
        K.destroy()
