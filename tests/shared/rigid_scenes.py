"""A block that a rigid obstacle presses, by a displacement or by a force, turned or not."""

import contact_scenes as cs
import numpy as np
import pairs
import scenes
from dolfinx import fem
from facing_scenes import turn
from mpi4py import MPI

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.forms import choice

FORMS = {"flexibility": ("saddle", 10**6), "saddle": ("saddle", 0), "condensed": ("condensed", 0)}


class Block:
    """A block [-1, 1]^(gdim - 1) x [0, 1] held at its top; an obstacle presses from below.

    Args:
        kind: of its cells.
        obstacle: function of the rotation R, its columns the block's axes, that gives it.
        law: contact law.
        form: of ``FORMS``.
        seed: of the rotation; None: none.
        comm: MPI communicator.
        rollers: held at its top in that direction alone, and at its axis across it.
    """

    def __init__(
        self, kind, obstacle, law, form="flexibility", seed=None, comm=MPI.COMM_SELF, rollers=False
    ):
        rng = np.random.default_rng(7)
        if kind in ("triangle", "quadrilateral"):
            body = cs.rectangle(comm, (7, 4), (-1, 0), (1, 1), kind, 0.2, rng)
        else:
            body = pairs.block(comm, (4, 4, 2), (-1, -1, 0), (1, 1, 1), kind, jitter=0.2, rng=rng)
        gdim = self.gdim = body[0].geometry.dim
        self.R, self.obstacle = turn(gdim, seed), obstacle(turn(gdim, seed))
        V = compat.function_space(body[0], shape=(gdim,))
        bcs = rolling(V) if rollers else self._clamped(V)
        body[0].geometry.x[:, :gdim] = body[0].geometry.x[:, :gdim] @ self.R.T
        solver, choice.FLEXIBLE = FORMS[form]
        self.problem = llm.ContactProblem(
            *scenes.forms(V),
            bcs=bcs,
            interfaces=[llm.Interface(body[1], (cs.BELOW, self.obstacle), law=law)],
            solver=solver,
        )

    def _clamped(self, V):
        """Held at its top, which ``top``, a Function of nodal vectors, moves."""
        self.top = fem.Function(V)
        at = fem.locate_dofs_geometrical(V, lambda p: p[self.gdim - 1] > 1.0 - 1e-9)
        return [fem.dirichletbc(self.top, at)]

    def solve(self, increments=1, **pose):
        """Motions and forces of the obstacle in the block's axes; what is not given stays."""
        for name, value in pose.items():
            if value is not None and name != "rotation" and None not in value:
                value = tuple(self.R @ np.array(value, float))
            setattr(self.obstacle, name, value)
        self.problem.solve(increments)
        return self.problem.results[0]

    def own(self, vectors):
        """Vectors in the block's axes."""
        return vectors @ self.R


def rolling(V):
    """Free but for its top's height and, there, two corners that fix the rest."""
    gdim = V.mesh.geometry.dim

    def corner(x, axes):
        def at(p):
            return np.all([np.isclose(p[k], v) for k, v in enumerate(x)], axis=0)

        return [(k, at) for k in axes]

    where = [(gdim - 1, lambda p: np.isclose(p[gdim - 1], 1.0))]
    where += corner((-1.0,) * (gdim - 1) + (1.0,), range(gdim - 1))
    where += corner((1.0, -1.0, 1.0), [1]) if gdim == 3 else []
    return scenes.hold(V, where, lambda p: np.zeros((gdim, p.shape[1])))


def stack(laws, form, plane, comm=MPI.COMM_SELF):
    """Two rectangles on each other, the lower one clamped, a plane on the upper one's top.

    Args:
        laws: of the bodies' interface, and of the plane.
        form: of ``FORMS``.
        plane: at height 2, or the force that presses it.

    Returns:
        The problem, solved, and its displacements (n,).
    """
    rng = np.random.default_rng(5)
    if isinstance(plane, tuple):
        plane = llm.RigidPlane((0.0, 2.0), (0.0, -1.0), force=plane)
    made = [
        cs.rectangle(comm, (n, 3), (-1, z), (1, z + 1), "triangle", 0.2, rng)
        for n, z in ((5, 0), (4, 1))
    ]
    spaces = [compat.function_space(d, shape=(2,)) for d, _ in made]
    at = fem.locate_dofs_geometrical(spaces[0], scenes.on(1, 0.0))
    solver, choice.FLEXIBLE = FORMS[form]
    tags = [t for _, t in made]
    interfaces = [
        llm.Interface(None, ((tags[0], cs.ABOVE), (tags[1], cs.BELOW)), law=laws[0]),
        llm.Interface(None, ((tags[1], cs.ABOVE), plane), law=laws[1]),
    ]
    bcs = [fem.dirichletbc(fem.Function(spaces[0]), at)]
    problem = scenes.elastic_problem(spaces, bcs, interfaces, solver=solver)
    return problem, np.concatenate([u.x.array for u in problem.solve()])
