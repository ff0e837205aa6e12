"""Random scenes at finite deformation: neo-Hookean bodies of ``random_scenes`` that move by several
times as much, and the conditions from the bodies' own residual and positions alone."""

import finite_patch
import numpy as np
import random_scenes as scenes
import ufl
from dolfinx import fem
from scene_oracle import load, rigid_clearance

import dolfinx_llm as llm

INCREMENTS = 2  # of each load step


def draw(seed):
    """Scene of a seed: no ties on obstacles, springs that hold, motions of up to a sixth of the
    bodies."""
    scene, rng = scenes.draw(seed), np.random.default_rng([seed, 97])
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


def _residual(form, V, u):
    """F of neo-Hookean bodies with the moduli, springs and load of linear ones."""
    a, L = form
    E, k = a.coefficients()
    w = ufl.TestFunction(V)
    mu, lam = E / (2 * (1 + scenes.NU)), E * scenes.NU / (1 + scenes.NU) / (1 - 2 * scenes.NU)
    W = finite_patch.energy(u, mu, lam) * ufl.dx(degree=2)
    return ufl.derivative(W, u, w) + k * ufl.inner(u, w) * ufl.dx - L


def pose(scene, variant=None, **kwargs):
    """A posed scene whose ``problem`` is nonlinear."""
    posed = scenes.pose(scene, variant, **kwargs)
    u = [fem.Function(V) for V in posed.spaces]
    F = [_residual(*given) for given in zip(posed.forms, posed.spaces, u, strict=True)]
    solver = posed.variant.solver or scene.solver
    one = len(F) == 1
    posed.problem = llm.NonlinearContactProblem(
        F[0] if one else F,
        u[0] if one else u,
        bcs=posed.bcs,
        interfaces=posed.interfaces,
        solver=solver,
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
        for form, nodes in zip(posed.residuals, posed.nodes, strict=True):
            self.R[nodes] = load(form).reshape(-1, gdim) @ posed.Q / self.unit
        self.U = max(np.abs(answer.u).max(), self.U)
        least = 1e-3 * self.U * min(b.E for b in self.scene.bodies)  # nothing touches: rounding
        self.F = max(np.abs(np.where(posed.held, 0.0, self.R)).max(), self.F, least)
        total = sum(answer.force, np.zeros_like(self.R))
        self.note("free", np.where(posed.held, 0.0, np.abs(self.R + total)) / self.F)
        for faces in self.groups():
            self.balance(faces)
        # K u - f says nothing of single interfaces where several act, or supports.
        others = (np.sum(answer.part, axis=0) > 1)[:, None] | posed.held
        for contact, result in zip(self.scene.contacts, answer.results, strict=True):
            faces = [contact.first, contact.second][: len(result.sides)]
            sides = result.sides[::-1] if posed.variant.swap and len(faces) == 2 else result.sides
            for face, side in zip(faces, sides, strict=True):
                nodes = scenes.face_nodes(posed, face, side.drawn)
                own = side.force @ posed.Q / self.unit
                force = np.where(others[nodes], own, -self.R[nodes])
                normal = side.normal @ posed.Q
                if len(faces) == 1:
                    displacement = posed.Q.T @ np.asarray(result.displacement) / posed.length
                    normal = self.clear(contact, nodes, force, displacement)
                elif result.frame.x.shape == side.x.shape and (result.frame.x == side.x).all():
                    continue  # it carries the frame: the law holds at the other one's nodes
                if contact.law.opens:
                    self.law(contact.law, side, force, normal)
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

    def clear(self, contact, nodes, force, displacement):
        """(n, gdim) directions into an obstacle, which bodies do not enter, by its own geometry."""
        clearance, into = rigid_clearance(contact.second, self.now[nodes] - displacement)
        pressing = np.einsum("ni,ni->n", force, into) / self.F
        self.note("overlap", -clearance / self.U)
        self.note("force of open pairs", np.abs(pressing)[clearance > 1e-8 * self.U])
        return into

    def law(self, law, side, force, normal):
        """Pairs press, within the cone of friction; gaps are not negative."""
        pressing = np.einsum("ni,ni->n", force, normal)
        tangential = np.linalg.norm(force - pressing[:, None] * normal, axis=1)
        self.note("pull", -pressing / self.F)
        gap = np.where(np.isfinite(side.gap), side.gap, 0.0) / self.posed.length
        self.note("overlap as reported", -gap / self.U)
        mu = getattr(law, "mu", 0.0)
        self.note("cone", (tangential - mu * np.maximum(pressing, 0.0)) / self.F)


def check(scene, variant=None):
    """Answers of a scene and the violations of each step; errors are the caller's."""
    seen = []

    def watch(posed):
        seen.append(Oracle(posed))
        return seen[0]

    return solve(scene, variant, watch), seen[0].found
