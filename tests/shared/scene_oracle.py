"""Conditions of contact, checked from K u - f and the positions alone.

K and f are assembled here by dolfinx, without conditions; the library's own residual, forces and
states are only compared with what follows from them. Everything is in the scene's units.
"""

from dataclasses import dataclass, replace

import dolfinx.fem.petsc
import numpy as np
import random_scenes as scenes
from dolfinx import fem

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.geometry.cells import facet_mass
from dolfinx_llm.geometry.loads import assembled
from dolfinx_llm.interface.control import frame_control
from dolfinx_llm.operators.petsc import local_csr

EPS = np.finfo(float).eps
GRAZES = 0.02  # of the normal force, friction of pairs that are about to part
CARRIES = 0.1  # the same of open pairs of a side that carries the frame


class Oracle:
    """Violations of a posed scene's load steps; call it after each, on one rank."""

    def __init__(self, posed):
        self.posed, self.scene = posed, posed.scene
        self.gdim = posed.scene.gdim
        self.unit = posed.modulus * posed.length ** (self.gdim - 1)
        self.K = [matrix(a) for a, _ in posed.forms]
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
        over = np.max(np.abs(value) - allowed, initial=0.0)
        worst = float(over) if np.isfinite(over) else np.inf
        self.worst[name] = max(self.worst.get(name, 0.0), worst)

    def residual(self):
        """K u - f at all nodes (all, gdim), in the scene's directions and units, and its noise."""
        posed, gdim = self.posed, self.gdim
        functions = posed.problem.u if isinstance(posed.problem.u, list) else [posed.problem.u]
        R, noise = np.zeros_like(posed.x), np.zeros(len(posed.x))
        for K, u, nodes, (_, L) in zip(self.K, functions, posed.nodes, posed.forms, strict=True):
            f = load(L)
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
        posed = self.posed
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
        faces = [contact.first]
        if not isinstance(contact.second[0], str):
            faces.append(contact.second)
        if posed.variant.swap and len(result.sides) == 2:
            faces = faces[::-1]
        geometry = posed.problem.geometries[i]
        sides = [
            self.side(s, p, scenes.face_nodes(posed, face, s.x), R, answer)
            for face, s, p in zip(faces, result.sides, geometry.pairs, strict=True)
        ]
        for side in sides:
            self.note("unit normals", np.linalg.norm(side.normal, axis=1) - 1.0)
        if result.frame is None:
            self.obstacle(contact, sides[0], answer)
            return
        Y, v = (a @ posed.Q / posed.length for a in (result.frame.x, result.frame.v))
        if (
            any(side.control is not None for side in sides) and not contact.law.ties
        ):  # the frame's as well
            E = frame_control(result.frame).toarray()
            Y, v = np.linalg.solve(E, Y), np.linalg.solve(E, v)
        N = [p.N for p in geometry.pairs]
        normals = np.concatenate([sides[0].normal, -sides[1].normal])
        flat = not self.scene.radius and np.ptp(normals, axis=0).max() < 1e-9
        across = geometry.directions[:, -1] @ posed.Q if geometry.normals_alone else None
        acting = self.acting(i, geometry, sides)
        self.balance(N, sides, Y, flat, across, acting)
        law, opens = contact.law, not isinstance(contact.law, llm.Tied)
        for k, (M, side, p) in enumerate(zip(N, sides, geometry.pairs, strict=True)):
            self.rows(M, side, Y, flat)
            jump = side.u - M @ v
            if law.closes_gap and np.ptp(normals, axis=0).max() > 1e-9:  # of smooth surfaces
                drawn = p.gap @ posed.Q / posed.length  # across them: nodes beyond a rim stay
                height = np.einsum("ni,ni->n", drawn, side.normal)
                jump = jump + height[:, None] * side.normal
            elif law.closes_gap:
                jump = jump + side.x - M @ Y
            if opens:
                gap = -np.einsum("ni,ni->n", jump, side.normal)
                if across is not None:  # the mean of the nodes' normal motions
                    mean = M @ across
                    gap -= np.einsum("ni,ni->n", M @ v, side.normal)
                    moved = M @ np.einsum("mi,mi->m", v, across)
                    gap += moved / np.einsum("ni,ni->n", mean, side.normal)
                told = geometry.site.prescribed == k  # by shares of the other side's
                self.opening(gap, side, told or geometry.site.carrier == k)
                if not getattr(law, "mu", 0.0):
                    tangential = np.linalg.norm(acting[k].tangential, axis=1) / self.F
                    self.note("friction without mu", tangential, side.noise)
            else:
                self.note("tied jump", np.abs(jump)[~posed.held[side.nodes]] / self.U)
        if getattr(law, "mu", 0.0):
            self.friction(law.mu, N, sides, result, geometry.law_side)

    def side(self, result, pairs, nodes, R, answer):
        """Forces of a side: by K u - f where nothing else acts at the node, else as reported; in
        control values of Bernstein form where bodies of second order may part."""
        posed = self.posed
        own = result.force @ posed.Q / self.unit
        others = np.sum(answer.part, axis=0)[nodes] > 1
        force = np.where(posed.held[nodes] | others[:, None], own, -R[nodes])
        normal = result.normal @ posed.Q
        reported = getattr(result, "frame_gap", None)
        reported = (result.gap if reported is None else reported) / posed.length
        noise, x = self.noise[nodes] / self.F, posed.x[nodes]
        values, E, weights = [x, answer.u[nodes], self.before[nodes], reported], None, None
        if pairs.control is not None:
            E = pairs.control.toarray()
            assert np.abs(E @ np.ones(len(E)) - 1.0).max() < 1e-12 and E.min() >= 0.0
            force, noise = E.T @ force, E.T @ noise
            values = [np.linalg.solve(E, a) for a in values]
            thickness = pairs.surface.thickness
            thickness = None if thickness is None else thickness[pairs.nodes]
            blocks = facet_mass(x, pairs.cells, thickness)
            weights = E.T @ assembled(blocks, pairs.cells, len(x)).toarray()
        *motion, reported = values
        return Side(nodes, *motion, force, normal, noise, reported, E, weights)

    def rows(self, M, side, Y, flat):
        """Rows of L_b let rigid translations pass, and on flat frames linear fields."""
        self.note("partition of unity", np.asarray(M.sum(axis=1)).ravel() - 1.0)
        off = side.x - M @ Y
        off -= np.einsum("ni,ni->n", off, side.normal)[:, None] * side.normal
        if flat:
            self.note("linear fields", off)

    def opening(self, gap, side, carries=False):
        """Pairs press and do not overlap; those that are apart carry nothing, or if they carry the
        frame no normal force."""
        self.note("gap as reported", (side.reported - gap) / self.U)
        self.note("pull", np.maximum(-side.pressing, 0.0) / self.F, side.noise)
        self.note("overlap", np.maximum(-gap, 0.0) / self.U)
        apart = gap > 1e-8 * self.U
        carried = np.linalg.norm(side.force, axis=1) / self.F
        if carries:
            carried = np.abs(side.pressing) / self.F
        self.note("force of open pairs", carried[apart], side.noise[apart])

    def acting(self, i, geometry, sides):
        """The sides with forces by the equations, where results share those of a tool out."""
        k, problem = geometry.site.prescribed, self.posed.problem
        if k is None:
            return sides
        base = np.concatenate([pairs.base for pairs in geometry.pairs])
        found = problem.method.iteration.multiplier[problem.operators.places[i].rows]
        found = np.einsum("nc,nci->ni", found.reshape(base.shape[:2]), base)
        force = np.split(found @ self.posed.Q / self.unit, [len(sides[0].x)])[k]
        return [replace(side, force=force) if j == k else side for j, side in enumerate(sides)]

    def balance(self, N, sides, Y, flat, across, acting):
        """Forces of both sides cancel, at every frame node too, there of the sides ``acting``, and
        so do their moments; without friction those along the nodes' normals ``across``, of which
        the pairs' are the means."""
        noisy = sum(side.noise.sum() for side in sides)
        self.note("sum", sum(side.force.sum(axis=0) for side in sides) / self.F, noisy)
        forces = [side.force for side in acting]
        if across is not None:
            forces = [
                side.pressing / np.einsum("ni,ni->n", M @ across, side.normal)
                for M, side in zip(N, acting, strict=True)
            ]
        at_frame = sum(M.T @ force for M, force in zip(N, forces, strict=True))
        self.note("frame equilibrium", at_frame / self.F, noisy)
        moment = np.zeros((self.gdim, self.gdim))
        for M, side in zip(N, sides, strict=True):
            moment += (M @ Y - Y.mean(axis=0)).T @ side.force
        if flat:
            self.note("moment", (moment - moment.T) / self.F, noisy)

    def friction(self, mu, N, sides, result, law_side):
        """Coulomb's law in total, at the frame's nodes, or at every node of the side at which it
        holds, and the work of friction."""
        noisy = sum(side.noise.sum() for side in sides)
        first = sides[law_side or 0]
        total = np.linalg.norm(first.tangential.sum(axis=0))
        limit = mu * first.pressing.sum()
        self.note("friction in total", max(total - limit, 0.0) / self.F, noisy)
        for k, side in enumerate(sides):
            idle = side.pressing <= np.maximum(side.noise, 1e-10) * self.F
            borne = np.linalg.norm(side.tangential[idle], axis=1).sum()
            part = GRAZES if law_side in (None, k) else CARRIES
            borne -= part * np.maximum(side.pressing, 0.0).sum()
            self.note("friction that nothing presses", max(borne, 0.0) / self.F, noisy)
        T = np.linalg.norm(result.frame_friction, axis=1) / self.unit
        limit = mu * np.maximum(result.frame_force, 0.0) / self.unit
        self.note("cone as reported", np.maximum(T - limit, 0.0) / self.F, noisy)
        # What corrected rows pull at a node is missing in what its neighbours bear.
        slip = result.frame_status == 2
        less = limit - T - mu * np.maximum(-result.frame_force, 0.0).sum() / self.unit
        if law_side is not None:
            T = np.linalg.norm(first.tangential, axis=1)
            limit = mu * np.maximum(first.pressing, 0.0)
            self.note("cone", np.maximum(T - limit, 0.0) / self.F, noisy)
            slip, less = result.sides[law_side].status == 2, limit - T
        self.note("slip below the limit", np.maximum(less, 0.0)[slip] / self.F, noisy)
        T = np.linalg.norm(N[0].T @ sides[0].tangential, axis=1)
        limit = mu * np.maximum(N[0].T @ sides[0].pressing, 0.0)
        self.note("(cone at frame nodes)", np.maximum(T - limit, 0.0) / self.F, noisy)
        work = sum(np.sum(side.tangential * (side.u - side.before)) for side in sides)
        self.note("(work of friction)", max(-work, 0.0) / (self.F * self.U), noisy)

    def obstacle(self, contact, side, answer):
        """A body against a rigid obstacle, by the obstacle's own geometry."""
        law, nodes = contact.law, side.nodes
        clearance, into = rigid_clearance(contact.second, self.posed.x[nodes])
        if side.control is not None:
            clearance, into = self.in_control_values(clearance, into, side, law)
        self.note("direction", into - side.normal)
        motion, before = self.motion(contact, self.step), self.motion(contact, self.step - 1)
        jump = side.u - motion
        if isinstance(law, llm.Tied):
            if law.closes_gap:
                jump = jump - clearance[:, None] * into
            self.note("tied jump", np.abs(jump)[~self.posed.held[nodes]] / self.U)
            return
        self.opening(clearance - np.einsum("ni,ni->n", jump, into), side)
        T = np.linalg.norm(side.tangential, axis=1)
        limit = getattr(law, "mu", 0.0) * np.maximum(side.pressing, 0.0)
        self.note("cone", np.maximum(T - limit, 0.0) / self.F, 2 * side.noise)
        # Slip against the obstacle since the last step, where the node was in contact then.
        was = clearance - np.einsum("ni,ni->n", side.before - before, into)
        both = (was < 1e-9 * self.U) & (side.pressing > 1e-6 * self.F) & (self.step > 1)
        slip = (side.u - side.before) - (motion - before)
        slip -= np.einsum("ni,ni->n", slip, into)[:, None] * into
        size = np.linalg.norm(slip, axis=1)
        inside = both & (limit * (1 - 1e-6) - 2 * side.noise * self.F > T)
        self.note("slip below the limit", (size / self.U)[inside])
        power = np.einsum("ni,ni->n", side.tangential, slip)  # on the obstacle: positive
        against = (T * size - power) / (self.F * self.U)
        self.note("direction of slip", against[both], side.noise[both])

    def in_control_values(self, clearance, into, side, law):
        """(n,) clearances and (n, gdim) directions into an obstacle that control values meet: along
        what a constant pressure exerts at them, with friction in planes that supports hold."""
        away = side.of_nodes(clearance[:, None] * into)
        if isinstance(law, llm.Tied):
            return np.einsum("ni,ni->n", away, into), into
        mean = side.weights @ into
        if getattr(law, "mu", 0.0):
            mean[self.posed.held[side.nodes] & (np.abs(into) < 1e-3)] = 0.0
        into = mean / np.linalg.norm(mean, axis=1)[:, None]
        return np.einsum("ni,ni->n", away, into), into

    def motion(self, contact, step):
        """(gdim,) of an obstacle in a step."""
        if not contact.moves or step < 1:
            return np.zeros(self.gdim)
        down, drag, _, _ = self.scene.steps[step - 1]
        return np.append(drag, -down)


@dataclass
class Side:
    """One side of an interface, in the scene's directions and units."""

    nodes: np.ndarray  # (n,) of the scene
    x: np.ndarray  # (n, gdim) their positions
    u: np.ndarray  # (n, gdim) displacements
    before: np.ndarray  # (n, gdim) at the last step
    force: np.ndarray  # (n, gdim) that the body exerts on the frame
    normal: np.ndarray  # (n, gdim) out of the body
    noise: np.ndarray  # (n,) of the forces, relative
    reported: np.ndarray  # (n,) gap to the frame
    control: object = None  # (n, n) by which nodal values follow from these control values
    weights: object = None  # (n, n) integrals of their functions times the nodes'

    def of_nodes(self, values):
        """Nodes' values (n, ...) as all of these are."""
        return values if self.control is None else np.linalg.solve(self.control, values)

    @property
    def pressing(self):
        return np.einsum("ni,ni->n", self.force, self.normal)

    @property
    def tangential(self):
        return self.force - self.pressing[:, None] * self.normal


def matrix(a):
    """Of a bilinear form, without conditions, on one rank."""
    return local_csr(compat.assemble_matrix(fem.form(a), [], 0.0))


def load(L):
    """Load of a linear form, this rank's."""
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

    def watch(posed):
        oracle = Oracle(posed)
        return lambda answer: found.append(oracle(posed, answer))

    return scenes.solve(scene, variant, watch=watch), found
