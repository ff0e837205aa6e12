"""A cantilever between two things that touch it: every pair of laws, and conditions that are held
against K u - f and positions alone."""

import numpy as np
import pairs
import ufl
from contact_scenes import ABOVE, BELOW, rectangle, stress
from dolfinx import fem, mesh
from scipy.spatial import cKDTree

import dolfinx_llm as llm
from dolfinx_llm import compat

MU = 0.3
DEFORMABLE = {
    "tied": llm.Tied(), "smooth": llm.Frictionless(), "rough": llm.Coulomb(MU),
    "zero": llm.Coulomb(0.0),
}  # fmt: skip
RIGID = {f"rigid {name}": law for name, law in DEFORMABLE.items()}
LAWS = DEFORMABLE | RIGID
# The counterpart below and above moves by these (along x, towards the cantilever): pressed,
# dragged, lifted off, pressed again.
STEPS = (((0.0, 0.012), (0.0, 0.01)), ((-0.004, 0.012), (0.01, 0.01)), ((0.0, 0.01), (0.0, -0.02)),
         ((0.0, 0.0), (0.0, 0.012)))  # fmt: skip


class Checked:
    """Bodies, whose solution is held against the conditions by K u - f and positions alone.

    Attributes: comm, gdim, problem, spaces, a (forms), held (where each body's nodes are
    prescribed), u (of the last solve).
    """

    def nodes(self):
        """Per body positions, displacements and K u - f at all nodes, on every rank."""
        out = []
        for V, a, u in zip(self.spaces, self.a, self.u, strict=True):
            K = compat.assemble_matrix(fem.form(a), [], 1.0)
            x, y = K.createVecs()
            n = x.local_size
            x.array_w[:] = u.x.array[:n]
            K.mult(x, y)
            size = n // self.gdim
            own = V.tabulate_dof_coordinates()[:size, : self.gdim]
            parts = own, u.x.array[:n].reshape(size, -1), y.array_r.reshape(size, -1).copy()
            out.append([np.concatenate(self.comm.allgather(part)) for part in parts])
            for item in (K, x, y):
                item.destroy()
        return out

    def violations(self):
        """Largest violation of each condition, by the largest force and the largest motion."""
        bodies = self.nodes()
        force = max(np.abs(r).max() for _, _, r in bodies)
        force = max(force, 1e-3 * self.problem.scale * 0.01)  # where nothing touches
        size = max(np.abs(u).max() for _, u, _ in bodies)
        worst = {}

        def note(name, value, scale):
            worst[name] = max(worst.get(name, 0.0), float(np.max(value, initial=0.0)) / scale)

        free = [np.ones(len(x), dtype=bool) for x, _, _ in bodies]
        for (x, _, _), where, at in zip(bodies, self.held, free, strict=True):
            at[where(np.column_stack([x, np.zeros((len(x), 3 - self.gdim))]).T)] = False
        for geometry, result in zip(self.problem.geometries, self.problem.results, strict=True):
            found = []
            for space, side in zip(geometry.spaces, result.sides, strict=True):
                x, u, r = bodies[space]
                distance, at = cKDTree(x).query(side.x)
                assert distance.max() < 1e-12
                note("result u", np.abs(side.u - u[at]), size)
                note("result force", np.abs(side.force + r[at]), force)
                free[space][at] = False
                found.append((x[at], u[at], -r[at]))
            check = self._rigid if geometry.frame is None else self._frame
            check(
                geometry,
                result,
                found,
                lambda n, v: note(n, v, force),
                lambda n, v: note(n, v, size),
            )
        for (_, _, r), at in zip(bodies, free, strict=True):
            note("free nodes", np.abs(r[at]), force)
        return worst

    def _normal_law(self, law, F, gap, forces, lengths):
        """Signorini's conditions of normal forces and gaps."""
        if not law.opens:
            lengths("tied", np.abs(gap))
            return
        forces("pull", -F)
        lengths("overlap", -gap)
        forces("across a gap", np.where(gap > 1e-6, np.abs(F), 0.0))

    def _rigid(self, geometry, result, found, forces, lengths):
        """Each node against the plane; friction over the last load step is told by the result's
        own slip, which must be the node's."""
        (x, u, F), law, side = found[0], geometry.interface.law, result.sides[0]
        n, motion = side.normal, geometry.interface.obstacle.motion(found[0][0])
        normal = np.einsum("ni,ni->n", F, n)
        T = F - normal[:, None] * n
        relative = u - motion
        gap = geometry.interface.obstacle.clearance(x + relative)[0]
        self._normal_law(law, normal, gap, forces, lengths)
        if not law.opens:
            lengths("tied", np.abs(relative))
        else:
            self._friction(law, T, normal, forces)

    def _friction(self, law, T, N, forces):
        mu = getattr(law, "mu", 0.0)
        forces("cone", np.linalg.norm(T, axis=1) - mu * np.maximum(N, 0.0))

    def _frame(self, geometry, result, found, forces, lengths):
        """Forces of both sides cancel at the frame's nodes, which lie between the bodies."""
        law, v = geometry.interface.law, result.frame.v
        y = result.frame.x + v
        balance, normals = 0.0, []
        for p, (x, u, F), side in zip(geometry.pairs, found, result.sides, strict=True):
            n = side.normal
            normal = np.einsum("ni,ni->n", F, n)
            if law.opens and not getattr(law, "mu", 0.0):
                forces("cone", np.abs(F - normal[:, None] * n))
            along = np.einsum("ni,ni->n", p.N @ y - x - u, n)
            self._normal_law(law, normal, along, forces, lengths)
            if not law.opens:
                lengths("tied", np.abs(u - p.N @ v))
            balance = balance + p.N.T @ F
            normals.append((p.N.T @ normal, p.N.T @ (F - normal[:, None] * n)))
        forces("balance", np.abs(balance))
        if law.opens:
            (N_0, T_0), (N_1, T_1) = normals
            forces("result frame", np.abs(result.frame_force - N_0))
            total = np.abs(result.frame_friction.sum(axis=0) - T_0.sum(axis=0))
            forces("result frame", total)
            self._friction(law, result.frame_friction, N_0, forces)


class Cantilever(Checked):
    """A beam held at its left end; a block, or a rigid plane, below and above it.

    Args:
        comm: MPI communicator.
        gdim: 2 or 3.
        laws: names of ``LAWS`` below and above.
        solver: of ``ContactProblem``.
    """

    def __init__(self, comm, gdim, laws, solver="auto"):
        rng = np.random.default_rng(17)
        self.gdim, self.comm = gdim, comm
        beam = _block(comm, gdim, 8 if gdim == 2 else 5, (-1.0, 0.0), (1.0, 0.5), rng)
        meshes, self.moves, self.planes = [beam[0]], [None, None], [None, None]
        interfaces = []
        beam_tags = _without_left_end(beam[0], gdim)
        for i, (name, tag) in enumerate(zip(laws, (BELOW, ABOVE))):
            end, law = (0.0, 0.5)[i], LAWS[name]
            if name in RIGID:
                normal = np.zeros(gdim)
                normal[-1] = (1.0, -1.0)[i]
                self.planes[i] = llm.RigidPlane(end * np.abs(normal), normal)
                interfaces.append(llm.Interface(beam_tags, (tag, self.planes[i]), law=law))
                continue
            low, high = ((-0.35, -0.5), (0.9, 0.0)) if i == 0 else ((-0.25, 0.5), (0.8, 1.0))
            block = _block(comm, gdim, 6 if gdim == 2 else 3, low, high, rng)
            self.moves[i] = len(meshes)
            meshes.append(block[0])
            sides = [(beam_tags, tag), (block[1], (ABOVE, BELOW)[i])]
            interfaces.append(llm.Interface(None, tuple(sides[:: 1 - 2 * i]), law=law))
        self.spaces = [compat.function_space(d, shape=(gdim,)) for d in meshes]
        self.motions = [fem.Function(V) for V in self.spaces]
        bcs, self.held = [], []
        for k, V in enumerate(self.spaces):
            where = lambda p: p[0] < -1.0 + 1e-9  # noqa: E731
            if k:
                outer = -0.5 if self.moves[0] == k else 1.0
                where = lambda p, z=outer: np.isclose(p[gdim - 1], z)  # noqa: E731
            bcs.append(fem.dirichletbc(self.motions[k], fem.locate_dofs_geometrical(V, where)))
            self.held.append(where)
        self.a = [
            ufl.inner(stress(ufl.TrialFunction(V)), ufl.grad(ufl.TestFunction(V))) * ufl.dx
            for V in self.spaces
        ]
        zero = [fem.Constant(V.mesh, np.zeros(gdim)) for V in self.spaces]
        self.problem = llm.ContactProblem(
            self.a,
            [ufl.inner(c, ufl.TestFunction(V)) * ufl.dx for c, V in zip(zero, self.spaces)],
            bcs=bcs, interfaces=interfaces, solver=solver,
        )  # fmt: skip

    def move(self, step):
        """Solve with the counterparts moved; what is below moves up, what is above down."""
        for i, (along, towards) in enumerate(step):
            value = np.zeros(self.gdim)
            value[0], value[-1] = along, (1.0, -1.0)[i] * towards
            if self.planes[i] is not None:
                self.planes[i].displacement = value
            else:
                motion = self.motions[self.moves[i]]
                motion.interpolate(lambda p, v=value: np.repeat(v[:, None], p.shape[1], axis=1))
        self.u = self.problem.solve()
        return self.u


class Lifted(Checked):
    """A block apart from what is below it, a block or a rigid plane, moved at its top.

    Args:
        comm: MPI communicator.
        gdim: 2 or 3.
        name: of the law, of ``LAWS``.
        solver: of ``ContactProblem``.
        gap: between the bodies as drawn.
    """

    def __init__(self, comm, gdim, name, solver="auto", gap=0.05):
        rng = np.random.default_rng(11)
        self.gdim, self.comm, n = gdim, comm, 6 if gdim == 2 else 3
        block = _block(comm, gdim, n, (-0.6, gap), (0.6, 0.8 + gap), rng)
        meshes, side, law = [block[0]], (block[1], BELOW), LAWS[name]
        normal = np.eye(gdim)[-1]
        if name in RIGID:
            interface = llm.Interface(None, (side, llm.RigidPlane(0.0 * normal, normal)), law=law)
        else:
            base = _block(comm, gdim, n + 1, (-1.0, -0.8), (1.0, 0.0), rng)
            meshes.append(base[0])
            interface = llm.Interface(None, ((base[1], ABOVE), side), law=law)
        self.spaces = [compat.function_space(d, shape=(gdim,)) for d in meshes]
        self.held = [
            lambda p: np.isclose(p[gdim - 1], 0.8 + gap), lambda p: np.isclose(p[gdim - 1], -0.8)
        ][: len(meshes)]  # fmt: skip
        self.a, bcs, motions = [], [], []
        for V, where in zip(self.spaces, self.held):
            u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
            self.a.append(ufl.inner(stress(u), ufl.grad(w)) * ufl.dx)
            motions.append(fem.Function(V))
            bcs.append(fem.dirichletbc(motions[-1], fem.locate_dofs_geometrical(V, where)))
        self.motion = motions[0]
        zero = [fem.Constant(V.mesh, np.zeros(gdim)) for V in self.spaces]
        self.problem = llm.ContactProblem(
            self.a, [ufl.inner(c, ufl.TestFunction(V)) * ufl.dx for c, V in zip(zero, self.spaces)],
            bcs=bcs, interfaces=interface, solver=solver,
        )  # fmt: skip

    def move(self, down, along=0.0):
        """Solve with the top moved."""
        value = np.zeros(self.gdim)
        value[0], value[-1] = along, -down
        self.motion.interpolate(lambda p: np.repeat(value[:, None], p.shape[1], axis=1))
        self.u = self.problem.solve()
        return self.u


def _block(comm, gdim, n, low, high, rng):
    if gdim == 2:
        kind = str(rng.choice(["quadrilateral", "triangle"]))
        return rectangle(comm, (n, 2), low, high, kind, 0.2, rng)
    low, high = (low[0], 0.5 * low[0] + 0.3, low[1]), (high[0], 0.5 * high[0] + 0.3, high[1])
    kind = str(rng.choice(["hexahedron", "tetrahedron"]))
    return pairs.block(comm, (n, max(n - 2, 2), 1), low, high, kind, jitter=0.2, rng=rng)


def _without_left_end(domain, gdim):
    """BELOW and ABOVE of the beam's faces, without the facets next to its support."""
    found = [
        mesh.locate_entities_boundary(
            domain, gdim - 1, lambda p, z=z: np.isclose(p[gdim - 1], z) & (p[0] > -1.0 + 1e-9)
        )
        for z in (0.0, 0.5)
    ]
    values = np.repeat([BELOW, ABOVE], [len(f) for f in found]).astype(np.int32)
    facets = np.concatenate(found)
    order = np.argsort(facets)
    return mesh.meshtags(domain, gdim - 1, facets[order], values[order])
