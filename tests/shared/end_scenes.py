"""Two blocks, one on the other, held at foot and top by rigid ends, or by the same conditions."""

import numpy as np
from dolfinx import fem
from mpi4py import MPI
from scipy.spatial.transform import Rotation
from upright_blocks import FOOT, TOP, block

import dolfinx_llm as llm


def matrix(rotation):
    """Of an angle, or of a rotation vector."""
    if np.size(rotation) == 1:
        return Rotation.from_rotvec([0.0, 0.0, np.ravel(rotation)[0]]).as_matrix()[:2, :2]
    return Rotation.from_rotvec(rotation).as_matrix()


def vector(R):
    """Rotation vector of a matrix."""
    return Rotation.from_matrix(R).as_rotvec()


class Stack:
    """A wide block and a narrower one on it, which meet under a law, or one block alone.

    Attributes:
        ends: rigid obstacles that are tied to foot and top, pivots below and above the middle.
        held: Functions that are prescribed there in their place, where these are not ``tied``.
    """

    def __init__(self, kind, law, tied, degree=1, comm=MPI.COMM_SELF, high=2):
        parts = [block(kind, cells, degree, comm, high) for cells in ((3, 4) if law else (3,))]
        self.dim = dim = parts[0][0].geometry.dim
        for upper in parts[1:]:
            x = upper[0].geometry.x[:, :dim]
            x[:, :-1] = 0.2 + 0.6 * x[:, :-1]
            x[:, -1] += 1.0
        _, tags, self.spaces, self.u, self.F = map(list, zip(*parts, strict=True))
        up, height = np.eye(dim)[-1], float(len(parts))
        self.pivots = [np.full(dim, 0.3), 0.5 + (height - 0.7) * up]
        self.ends = [
            llm.RigidPlane(0.0 * up, up, pivot=self.pivots[0]),
            llm.RigidPlane(height * up, -up, pivot=self.pivots[1]),
        ]
        self.held, self.bcs, self.interfaces = [], [], []
        if law:
            sides = (tags[0], TOP), (tags[1], FOOT)
            self.interfaces.append(llm.Interface(None, sides, law=law))
        for end, tag, own, V in zip(
            self.ends, (FOOT, TOP), (tags[0], tags[-1]), (self.spaces[0], self.spaces[-1])
        ):
            self.held.append(fem.Function(V))
            if tied:
                self.interfaces.append(llm.Interface(own, (tag, end), law=llm.Tied()))
                continue
            at = fem.locate_dofs_topological(V, dim - 1, own.indices[own.values == tag])
            self.bcs.append(fem.dirichletbc(self.held[-1], at))

    def problem(self, **options):
        given = {"interfaces": self.interfaces} if self.interfaces else {}
        return llm.NonlinearContactProblem(self.F, self.u, bcs=self.bcs, **given, **options)

    def move(self, part, turn=0.5, press=0.04, drag=0.03, tilt=0.03):
        """All turn about the origin, the upper end by more; it presses and drags.

        Args:
            part: of the whole motion.
            turn, press, drag, tilt: angle; of the upper end how far it comes down and along, and
                how much more it turns.
        """
        axis = np.ones(1) if self.dim == 2 else np.array([1.0, 2.0, -2.0]) / 3.0
        apart = drag * np.eye(self.dim)[0] - press * np.eye(self.dim)[-1]
        R = matrix(part * turn * axis)
        for end, held, c, more in zip(self.ends, self.held, self.pivots, (0.0, 1.0)):
            whole = R @ matrix(part * more * tilt * np.eye(len(axis))[0])
            end.displacement = R @ (c + part * more * apart) - c
            end.rotation = part * (turn + more * tilt) if self.dim == 2 else vector(whole)
            x = held.function_space.tabulate_dof_coordinates()[:, : self.dim]
            held.x.array[:] = ((x - c) @ whole.T + c + end.displacement - x).ravel()

    def values(self):
        return np.concatenate([f.x.array for f in self.u])
