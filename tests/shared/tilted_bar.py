"""A bar that is tilted about its corner at (0, 0), with which it stands on a plate."""

import numpy as np
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem
from mpi4py import MPI

from dolfinx_llm import compat


class TiltedBar:
    """Attributes: ``spaces``, ``ends``, Functions of what moves the bar's top and the plate's foot,
    ``bcs``, and tagged ``sides``, of the bar first.

    Args:
        tilt: of the bar [rad].
        across: cells along it.
        degree: of the elements.
    """

    def __init__(self, tilt, across=8, degree=1):
        c, s = np.cos(tilt), np.sin(tilt)

        def tilted(x):
            return np.column_stack([c * x[:, 0] + s * x[:, 1], c * x[:, 1] - s * x[:, 0]])

        comm, kind = MPI.COMM_SELF, "quadrilateral"
        bar = rectangle(comm, (across, 2), (-2.0, 0.0), (0.0, 0.5), kind, move=tilted)
        plate = rectangle(comm, (25, 5), (-2.9, -1.0), (2.1, 0.0), kind)
        self.spaces = [compat.function_space(d, degree=degree, shape=(2,)) for d, _ in (bar, plate)]
        self.ends = [fem.Function(V) for V in self.spaces]
        held = (
            (lambda x: np.isclose(s * x[0] + c * x[1], 0.5)),
            (lambda x: np.isclose(x[1], -1.0)),
        )
        self.bcs = [
            fem.dirichletbc(end, fem.locate_dofs_geometrical(V, where))
            for V, end, where in zip(self.spaces, self.ends, held, strict=True)
        ]
        self.sides = (bar[1], BELOW), (plate[1], ABOVE)

    def pressed(self, problem, motions):
        """Normal forces after motions of the bar's top, downwards."""
        forces = []
        for down in motions:
            self.ends[0].x.array[1::2] = -down
            problem.solve()
            forces.append(abs(problem.results[0].resultant[1]))
        return forces
