"""What can be said of a solution of (31): rounding."""

from __future__ import annotations

import numpy as np


def rounding_error(comm, diagonal, u: np.ndarray, f: np.ndarray, multiplier: np.ndarray) -> float:
    """Relative error of the forces that rounding alone may cause, whatever the solver.

    A stiff body that hangs on a soft one moves far: the forces in it are differences of terms of
    the size K_ii u_i, and their rounding is not small against the loads.

    Args:
        comm: MPI communicator.
        diagonal: this rank's diagonal of K.
        u, f, multiplier: this rank's displacements, loads and multipliers.
    """
    free = (diagonal != 1.0) | (np.abs(u - f) > 1e-12 * np.abs(u))  # not an identity row
    largest = [
        np.abs(diagonal * u)[free].max(initial=0.0),
        max(np.abs(f)[free].max(initial=0.0), np.abs(multiplier).max(initial=0.0)),
    ]
    terms, forces = np.max(comm.allgather(largest), axis=0)
    return float(np.finfo(float).eps * terms / forces) if forces > 0.0 else 0.0
