"""Conditions of contact, checked from K u - f and the positions alone.

K and f are assembled here by dolfinx, without conditions; the library's own residual, forces and
states are only compared with what follows from them. Everything is in the scene's units.
"""

import random_scenes as scenes
import numpy as np
from dolfinx import fem
from scipy.sparse import csr_matrix

import dolfinx_llm as llm
from dolfinx_llm import compat

EPS = np.finfo(float).eps


class Oracle:
    """Violations of a posed scene's load steps; call it after each, on one rank."""

    def __init__(self, posed):
        self.posed, self.scene = posed, posed.scene
        self.gdim = posed.scene.gdim
        self.unit = posed.modulus * posed.length ** (self.gdim - 1)
        self.K = []
        for a, _ in posed.forms:
            K = compat.assemble_matrix(fem.form(a), [], 0.0)
            self.K.append(csr_matrix(K.getValuesCSR()[::-1], shape=K.getSize()[0:1] * 2))
        self.before = np.zeros_like(posed.x)
        self.largest = 0.0  # force so far
        self.U = 1e-6  # displacement so far
        self.step = 0

    def __call__(self, posed, answer):
        """Violations of this step, {name: relative size}."""
        self.step += 1
        self.worst = {}
        R, noise = self.residual()
        self.noise = noise
        self.U = max(np.abs(answer.u).max(), self.U)
        least = 1e-3 * self.U * min(b.E for b in self.scene.bodies)  # nothing touches: rounding
        self.F = self.largest = max(np.abs(R).max(), self.largest, least)
        self.free_nodes(R, answer)
        self.conditions(answer)
        for i, contact in enumerate(self.scene.contacts):
            self.interface(i, contact, R, answer)
        self.before = answer.u.copy()
        return self.worst

    def note(self, name, value, allowed=0.0):
        """Keep the largest violation beyond what rounding allows."""
        value = np.abs(value) if np.ndim(value) == 0 else np.asarray(value)
        over = np.max(value - allowed, initial=0.0) if np.size(value) else 0.0
        if not np.isfinite(over):
            over = np.inf
        self.worst[name] = max(self.worst.get(name, 0.0), float(over))

    def residual(self):
        """K u - f at all nodes (all, gdim), in the scene's directions and units, and its noise."""
        posed, gdim = self.posed, self.gdim
        functions = posed.problem.u if isinstance(posed.problem.u, list) else [posed.problem.u]
        R, noise = np.zeros_like(posed.x), np.zeros(len(posed.x))
        for K, u, nodes, (_, L) in zip(self.K, functions, posed.nodes, posed.forms, strict=True):
            f = compat_vector(L)
            r = (K @ u.x.array - f).reshape(-1, gdim)
            R[nodes] = r @ posed.Q / self.unit
            rough = (abs(K) @ np.abs(u.x.array)).reshape(-1, gdim).max(axis=1)
            noise[nodes] = 50 * EPS * rough / self.unit
        return R, noise

    def free_nodes(self, R, answer):
        """Equilibrium: R is what the interfaces report, nothing elsewhere."""
        total = sum(answer.force, np.zeros_like(R))
        touched = np.any(answer.part, axis=0)
        noise = self.noise / self.F
        off = np.where(self.posed.held, 0.0, np.abs(R)).max(axis=1) / self.F
        self.note("free", off[~touched], noise[~touched])
        miss = np.where(self.posed.held, 0.0, np.abs(R + total)).max(axis=1) / self.F
        self.note("reaction", miss[touched], noise[touched])

    def conditions(self, answer):
        """Prescribed displacements."""
        posed, gdim = self.posed, self.gdim
        down, drag, turn, _ = self.scene.steps[self.step - 1]
        last = len(self.scene.bodies) - 1
        held = posed.held
        known = np.zeros_like(posed.x)
        top = held.all(axis=1) & (posed.body == last) & (self.scene.load == "motion")
        if last == 0 and self.scene.base == "clamped":
            top &= posed.x[:, -1] > self.scene.bodies[0].low + 0.25
        known[top, :-1] = drag
        known[top, -1] = (-down + turn * posed.x[:, 0])[top]
        self.note("bcs", np.abs(answer.u - known)[held] / max(np.abs(known).max(), 1e-3))

    def interface(self, i, contact, R, answer):
        """One interface: its forces, gaps, friction."""
        posed, result = self.posed, answer.results[i]
        model = posed.problem.models[i]
        faces = [contact.first]
        if not isinstance(contact.second[0], str):
            faces.append(contact.second)
        sides, pairs = list(result.sides), list(model.pairs)
        if posed.variant.swap and len(sides) == 2:
            faces = faces[::-1]
        at = [scenes.face_nodes(posed, face, s.x) for face, s in zip(faces, sides, strict=True)]
        # The forces, by the residual where nothing else acts at the node.
        held = posed.held
        count = np.sum(answer.part, axis=0)
        forces, normals = [], []
        for nodes, s in zip(at, sides, strict=True):
            own = s.force @ posed.Q / self.unit
            alone = ~held[nodes] & (count[nodes] <= 1)[:, None]
            forces.append(np.where(alone, -R[nodes], own))
            normals.append(s.normal @ posed.Q)
        noise = [self.noise[n] / self.F for n in at]
        noisy = float(sum(n.sum() for n in noise))
        self.note("unit normals", np.concatenate([np.abs(np.linalg.norm(n, axis=1) - 1) for n in normals]))
        frame = result.frame
        if frame is None:
            self.obstacle(i, contact, at[0], forces[0], normals[0], noise[0], sides[0], answer)
            return
        total = np.sum([f.sum(axis=0) for f in forces], axis=0)
        self.note("sum", np.abs(total).max() / self.F, noisy)
        Y = frame.x @ posed.Q / posed.length
        v = frame.v @ posed.Q / posed.length
        flat = not self.scene.radius and np.abs(np.ptp(np.concatenate(normals) * np.concatenate([np.full(len(n), s) for n, s in zip(normals, (1, -1))])[:, None], axis=0)).max() < 1e-9
        N = [p.N for p in pairs]
        for M, nodes, n in zip(N, at, normals, strict=True):
            self.note("partition of unity", np.abs(np.asarray(M.sum(axis=1)).ravel() - 1.0).max())
            off = posed.x[nodes] - M @ Y
            off -= np.einsum("ni,ni->n", off, n)[:, None] * n
            if flat:
                self.note("linear fields", np.abs(off).max())
        self.balance(N, forces, Y, flat, noisy)
        law = contact.law
        opens = not isinstance(law, llm.Tied)
        gaps = []
        for M, nodes, n, s, f, p in zip(N, at, normals, sides, forces, pairs, strict=True):
            drawn = posed.x[nodes] - M @ Y
            jump = answer.u[nodes] - M @ v
            if opens or law.close_gap:
                jump = jump + drawn
            if not opens:
                free = ~held[nodes]
                self.note("tied jump", np.abs(jump)[free].max(initial=0.0) / self.U)
                continue
            gap = -np.einsum("ni,ni->n", jump, n)
            gaps.append(gap)
            reported = getattr(s, "frame_gap", None)
            reported = s.gap if reported is None else reported
            self.note("gap as reported", np.abs(reported / posed.length - gap).max() / self.U)
            normal = np.einsum("ni,ni->n", f, n)
            tangential = f - normal[:, None] * n
            eps = self.noise[nodes] / self.F
            self.note("pull", -normal / self.F, eps)
            self.note("overlap", -gap / self.U)
            # a pair that is apart carries nothing
            apart = gap > 1e-8 * self.U
            self.note("force of open pairs", (np.linalg.norm(f, axis=1) / self.F)[apart], eps[apart])
            if not getattr(law, "mu", 0.0):
                self.note("friction without mu", np.linalg.norm(tangential, axis=1) / self.F, eps)
        if opens and getattr(law, "mu", 0.0):
            self.friction(law.mu, N, forces, normals, at, result, answer, noisy)

    def balance(self, N, forces, Y, flat, noisy):
        """Forces of both sides cancel at every frame node, and their moments."""
        at_frame = sum(M.T @ f for M, f in zip(N, forces, strict=True))
        self.note("frame equilibrium", np.abs(at_frame).max() / self.F, noisy)
        if flat:
            middle = Y.mean(axis=0)
            moment = np.zeros(3)
            for M, f in zip(N, forces, strict=True):
                arm = np.zeros((len(f), 3))
                force = np.zeros((len(f), 3))
                arm[:, : self.gdim] = M @ Y - middle
                force[:, : self.gdim] = f
                moment += np.cross(arm, force).sum(axis=0)
            self.note("moment", np.abs(moment).max() / self.F, noisy)

    def friction(self, mu, N, forces, normals, at, result, answer, noisy):
        """Coulomb's law in total, at the frame's nodes, and the work of friction."""
        n_total = t_total = 0.0
        work = 0.0
        unit = self.unit
        for k, (f, n, nodes) in enumerate(zip(forces, normals, at, strict=True)):
            normal = np.einsum("ni,ni->n", f, n)
            tangential = f - normal[:, None] * n
            step = answer.u[nodes] - self.before[nodes]
            work += np.einsum("ni,ni->", tangential, step)
            if k == 0:
                n_total = normal.sum()
                t_total = np.linalg.norm(tangential.sum(axis=0))
                N_J = N[0].T @ normal
                T_J = N[0].T @ tangential
        self.note("friction in total", (t_total - mu * n_total) / self.F if t_total > mu * n_total else 0.0, noisy)
        T = np.linalg.norm(result.frame_friction, axis=1) / unit
        P = result.frame_force / unit
        self.note("cone as reported", (T - mu * np.maximum(P, 0.0)) / self.F, noisy)
        own = np.linalg.norm(T_J, axis=1)
        self.note("(cone at frame nodes)", (own - mu * np.maximum(N_J, 0.0)) / self.F, noisy)
        slip = result.frame_status == 2
        self.note("slip below the limit", ((mu * P - T) / self.F)[slip], noisy)
        self.note("(work of friction)", max(-work, 0.0) / (self.F * self.U), noisy)

    def obstacle(self, i, contact, nodes, f, n, noise, side, answer):
        """A body against a rigid obstacle, by the obstacle's own geometry."""
        posed, law = self.posed, contact.law
        clearance, into = rigid_clearance(contact.second, posed.x[nodes])
        self.note("direction", np.abs(into - n).max())
        motion = np.zeros(self.gdim)
        if contact.moves:
            down, drag, _, _ = self.scene.steps[self.step - 1]
            motion = np.append(drag, -down)
        jump = answer.u[nodes] - motion
        held = posed.held[nodes]
        if isinstance(law, llm.Tied):
            if law.close_gap:
                jump = jump - clearance[:, None] * into
            self.note("tied jump", np.abs(jump)[~held].max(initial=0.0) / self.U)
            return
        gap = clearance - np.einsum("ni,ni->n", jump, into)
        reported = getattr(side, "frame_gap", None)
        reported = side.gap if reported is None else reported
        self.note("gap as reported", np.abs(reported / posed.length - gap).max() / self.U)
        normal = np.einsum("ni,ni->n", f, into)
        tangential = f - normal[:, None] * into
        T = np.linalg.norm(tangential, axis=1)
        mu = getattr(law, "mu", 0.0)
        self.note("pull", -normal / self.F, noise)
        self.note("overlap", -gap / self.U)
        apart = gap > 1e-8 * self.U
        self.note("force of open pairs", (np.linalg.norm(f, axis=1) / self.F)[apart], noise[apart])
        self.note("cone", (T - mu * np.maximum(normal, 0.0)) / self.F, 2 * noise)
        # Slip against the obstacle since the last step, where the node was in contact then.
        last = np.zeros(self.gdim)
        if contact.moves and self.step > 1:
            down, drag, _, _ = self.scene.steps[self.step - 2]
            last = np.append(drag, -down)
        slip = (answer.u[nodes] - self.before[nodes]) - (motion - last)
        slip -= np.einsum("ni,ni->n", slip, into)[:, None] * into
        before = clearance - np.einsum("ni,ni->n", self.before[nodes] - last, into)
        both = (before < 1e-9 * self.U) & (normal > 1e-6 * self.F) & (self.step > 1)
        size = np.linalg.norm(slip, axis=1)
        inside = both & (T < mu * normal * (1 - 1e-6) - 2 * noise * self.F)
        self.note("slip below the limit", (size / self.U)[inside])
        power = np.einsum("ni,ni->n", tangential, slip)  # force on the obstacle by slip: positive
        self.note("direction of slip", ((T * size - power) / (self.F * self.U))[both], noise[both])


def compat_vector(L):
    """Load of a linear form, this rank's."""
    import dolfinx.fem.petsc

    b = dolfinx.fem.petsc.assemble_vector(fem.form(L))
    values = b.array_r.copy()
    b.destroy()
    return values


def rigid_clearance(what, x):
    """(n,) distance of the scene's points to an obstacle and (n, gdim) directions into it."""
    kind, point, value = what
    d = x - point
    if kind == "plane":
        return d @ value, np.broadcast_to(-value, x.shape)
    if kind == "cylinder":
        d = d * np.array([1.0, 0.0, 1.0])
    length = np.linalg.norm(d, axis=1)
    return length - value, -d / length[:, None]


def check(scene, variant=None):
    """Answers of a scene and the violations of each step; errors are the caller's."""
    found = []
    posed = scenes.pose(scene, variant)
    oracle = Oracle(posed)
    posed.make()
    answers = []
    for step in scene.steps:
        posed.set_step(step)
        posed.problem.solve()
        answers.append(scenes.collect(posed))
        found.append(oracle(posed, answers[-1]))
    posed.problem.destroy()
    return answers, found
