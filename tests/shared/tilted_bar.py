"""A bar that is tilted about its corner at (0, 0), with which it stands on a plate."""

import numpy as np
from contact_scenes import ABOVE, BELOW, rectangle
from dolfinx import fem, mesh
from mpi4py import MPI
from pairs import block

from dolfinx_llm import compat


class TiltedBar:
    """Attributes: ``spaces``, ``ends``, Functions of what moves the bar's top and the plate's foot,
    ``bcs``, and tagged ``sides``, of the bar first.

    Args:
        tilt: of the bar [rad].
        across: cells along it.
        degree: of the elements.
        gdim: 3 with a width of both bodies.
    """

    def __init__(self, tilt, across=8, degree=1, gdim=2):
        c, s = np.cos(tilt), np.sin(tilt)

        def tilted(x):
            along, up = x[:, 0], x[:, -1]
            return np.column_stack([c * along + s * up, *x.T[1:-1], c * up - s * along])

        comm, kind = MPI.COMM_SELF, "quadrilateral"
        if gdim == 2:
            bar = rectangle(comm, (across, 2), (-2.0, 0.0), (0.0, 0.5), kind, move=tilted)
            plate = rectangle(comm, (25, 5), (-2.9, -1.0), (2.1, 0.0), kind)
        else:
            kind, low, high = "hexahedron", (-2.0, 0.0, 0.0), (0.0, 0.5, 0.5)
            bar, _ = block(comm, (across, 2, 2), low, high, kind, move=tilted)
            under = mesh.locate_entities_boundary(
                bar, 2, lambda x: np.isclose(s * x[0] + c * x[2], 0.0)
            )
            tag = np.full(len(under), BELOW, dtype=np.int32)
            bar = bar, mesh.meshtags(bar, 2, np.sort(under), tag)
            plate = block(comm, (25, 4, 3), (-2.9, -0.1, -1.0), (2.1, 0.7, 0.0), kind)
        both = bar[0], plate[0]
        self.spaces = [compat.function_space(d, degree=degree, shape=(gdim,)) for d in both]
        self.ends = [fem.Function(V) for V in self.spaces]
        held = (
            (lambda x: np.isclose(s * x[0] + c * x[gdim - 1], 0.5)),
            (lambda x: np.isclose(x[gdim - 1], -1.0)),
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
            gdim = self.ends[0].function_space.mesh.geometry.dim
            self.ends[0].x.array[gdim - 1 :: gdim] = -down
            problem.solve()
            forces.append(abs(problem.results[0].resultant[-1]))
        return forces
