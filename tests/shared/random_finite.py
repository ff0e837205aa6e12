"""Random scenes at finite deformation: neo-Hookean bodies of ``random_scenes`` that move by several
times as much, and the conditions from the bodies' own residual and positions alone."""

import finite_patch
import numpy as np
import random_scenes as scenes
import ufl
from dolfinx import fem
from scene_oracle import load, rigid_clearance

import dolfinx_llm as llm
from dolfinx_llm.geometry.pairs import control_matrices

INCREMENTS = 2  # of each load step


def draw(seed, second=False):
    """Scene of a seed: no ties on obstacles, springs that hold, motions of up to a sixth of the
    bodies; with some bodies of second order."""
    scene, rng = scenes.draw(seed, second), np.random.default_rng([seed, 97])
    for contact in scene.contacts:
        rigid = isinstance(contact.second[0], str)
        if rigid and contact.law.ties:
            contact.law = llm.Coulomb(0.5)
        elif contact.law.ties:
            contact.law = llm.Tied(close_gap=True)
    for body in scene.bodies:
        body.E = float(np.clip(body.E, 1e-2, 1e2))
        body.spring = body.spring and max(body.spring, 1e-2)
    size = float(rng.uniform(2.0, 6.0))
    scene.solver = str(rng.choice(["saddle", "condensed"], p=[0.7, 0.3]))
    scene.steps = [tuple(size * np.asarray(part) for part in step) for step in scene.steps]
    return scene


def _residual(posed, form, U, order):
    """F of neo-Hookean bodies of an order with the moduli, springs and load of linear ones, U being
    their displacement or in a mixed space."""
    a, L = form
    E, k = a.coefficients()
    dU = ufl.TestFunction(U.function_space)
    u, w, others = scenes.parted(posed, U, dU, E)
    mu, lam = E / (2 * (1 + scenes.NU)), E * scenes.NU / (1 + scenes.NU) / (1 - 2 * scenes.NU)
    W = finite_patch.energy(u, mu, lam) * ufl.dx(degree=2 * order)
    return sum(others, ufl.derivative(W, U, dU) + k * ufl.inner(u, w) * ufl.dx - L)


def pose(scene, variant=None, **kwargs):
    """A posed scene whose ``problem`` is nonlinear."""
    posed = scenes.pose(scene, variant, **kwargs)
    u = [fem.Function(L.arguments()[0].ufl_function_space()) for _, L in posed.forms]
    orders = [b.order for b in scene.bodies][: len(u)]  # those on one mesh have one
    F = [_residual(posed, *of) for of in zip(posed.forms, u, orders, strict=True)]
    one = len(F) == 1
    posed.problem = llm.NonlinearContactProblem(
        F[0] if one else F,
        u[0] if one else u,
        bcs=posed.bcs,
        interfaces=posed.interfaces,
        solver=posed.solver,
    )
    posed.residuals = [fem.form(f) for f in F]
    return posed


def solve(scene, variant=None, watch=None, **kwargs):
    """See ``random_scenes``."""
    return scenes.answers_of(pose(scene, variant, **kwargs), watch, increments=INCREMENTS)


class Oracle:
    """Violations of each load step, {name: relative size}, on one rank."""

    def __init__(self, posed):
        self.posed, self.scene = posed, posed.scene
        self.found, self.F, self.U = [], 0.0, 1e-6

    def __call__(self, answer):
        posed, gdim, self.worst = self.posed, self.scene.gdim, {}
        self.unit = posed.modulus * posed.length ** (gdim - 1)
        self.R, self.now = np.zeros_like(posed.x), posed.x + answer.u
        loads = [0.0]  # which springs may bear where nothing touches
        for form, (_, L), nodes in zip(posed.residuals, posed.forms, posed.nodes, strict=True):
            self.R[nodes] = load(form).reshape(-1, gdim) @ posed.Q / self.unit
            loads.append(np.abs(load(L)).max() / self.unit)
        self.U = max(np.abs(answer.u).max(), self.U)
        least = 1e-3 * self.U * min(b.E for b in self.scene.bodies)  # nothing touches: rounding
        self.F = max(np.abs(np.where(posed.held, 0.0, self.R)).max(), *loads, self.F, least)
        total = sum(answer.force, np.zeros_like(self.R))
        self.note("free", np.where(posed.held, 0.0, np.abs(self.R + total)) / self.F)
        for faces in self.groups():
            self.balance(faces)
        # K u - f says nothing of single interfaces where several act, or supports.
        others = (np.sum(answer.part, axis=0) > 1)[:, None] | posed.held
        placed = posed.problem._newton.equations.interfaces
        for contact, result, of in zip(self.scene.contacts, answer.results, placed, strict=True):
            faces = [contact.first, contact.second][: len(result.sides)]
            faces = faces[::-1] if posed.variant.swap else faces
            sides = zip(faces, result.sides, of.what.sides.surfaces, strict=True)
            for face, side, surface in sides:
                if len(surface.x) != len(side.x):
                    continue  # its facets are divided: the law holds at nodes that are none here
                # Of bodies of second order, control values bear and part.
                E, C = (M.toarray() for M in control_matrices(surface))
                nodes = scenes.face_nodes(posed, face, side.drawn)
                own = side.force @ posed.Q / self.unit
                force = np.where(others[nodes], own, -self.R[nodes])
                normal, there = side.normal @ posed.Q, np.isfinite(side.gap)
                gap = C @ np.where(there, side.gap, 0.0) / posed.length
                gap[abs(C) @ ~there > 0.0] = 0.0
                if len(faces) == 1:
                    displacement = posed.Q.T @ np.asarray(result.displacement) / posed.length
                    gap, normal = self.clear(contact, nodes, displacement, C)
                elif result.frame.x.shape == side.x.shape and (result.frame.x == side.x).all():
                    continue  # it carries the frame: the law holds at the other one's nodes
                pressing, tangential = parts(force, normal, E)
                if len(faces) == 1:
                    carried = np.abs(pressing)[gap > 1e-8 * self.U]
                    self.note("force of open pairs", carried / self.F)
                if contact.law.opens:
                    self.law(contact.law, gap, pressing, tangential)
        self.found.append(self.worst)

    def note(self, name, value):
        """Keep the largest violation."""
        worst = float(np.max(value, initial=0.0))
        self.worst[name] = max(self.worst.get(name, 0.0), worst if np.isfinite(worst) else np.inf)

    def groups(self):
        """Surfaces that press one another, as sets of faces."""
        found = []
        for contact in self.scene.contacts:
            rigid = isinstance(contact.second[0], str)
            both = {contact.first, "rigid" if rigid else contact.second}
            joined = [g for g in found if g & (both - {"rigid"})]
            found = [g for g in found if g not in joined] + [both.union(*joined)]
        return [g for g in found if "rigid" not in g]

    def balance(self, faces):
        """Forces and moments of surfaces that press one another cancel, by the residual; where
        nothing else acts on them."""
        drawn = [self.posed.faces[face] for face in faces]
        nodes = np.unique(np.concatenate(drawn))
        last = (len(self.scene.bodies) - 1, scenes.TOP)
        if self.posed.held[nodes].any() or (self.scene.load == "force" and last in faces):
            return
        self.note("sum", np.abs(self.R[nodes].sum(axis=0)) / self.F)
        x = self.now[nodes]
        moment = (x - x.mean(axis=0)).T @ self.R[nodes]
        self.note("moment", np.abs(moment - moment.T) / self.F)

    def clear(self, contact, nodes, displacement, C):
        """(n,) gaps to an obstacle, which bodies do not enter, and (n, gdim) directions into it, by
        its own geometry; C gives the nodes' control values."""
        clearance, into = rigid_clearance(contact.second, self.now[nodes] - displacement)
        clearance = C @ clearance
        self.note("overlap", -clearance / self.U)
        return clearance, into

    def law(self, law, gap, pressing, tangential):
        """Pairs press, within the cone of friction; gaps are not negative."""
        self.note("pull", -pressing / self.F)
        self.note("overlap as reported", -gap / self.U)
        mu = getattr(law, "mu", 0.0)
        self.note("cone", (tangential - mu * np.maximum(pressing, 0.0)) / self.F)


def parts(force, normal, E):
    """(n,) normal and tangential forces p and |t| of pairs. Those at nodes are E^-T p along the
    nodes' normals, and E^-T t, with t across the pairs' own: at first order both are as usual."""
    (n, gdim), C = force.shape, np.linalg.inv(E)
    normal = np.where(normal.any(axis=1)[:, None], normal, np.eye(gdim)[-1])  # no frame is below
    across = np.linalg.svd(normal[:, None])[2][:, 1:]  # (n, gdim - 1, gdim)
    of_normal = np.einsum("pq,qi->qip", C, normal).reshape(n * gdim, n)
    of_across = np.einsum("pq,pai->qipa", C, across).reshape(n * gdim, -1)
    found = np.linalg.solve(np.concatenate([of_normal, of_across], axis=1), force.ravel())
    return found[:n], np.linalg.norm(found[n:].reshape(n, gdim - 1), axis=1)


def check(scene, variant=None):
    """Answers of a scene and the violations of each step; errors are the caller's."""
    seen = []

    def watch(posed):
        seen.append(Oracle(posed))
        return seen[0]

    return solve(scene, variant, watch), seen[0].found
