"""Random scenes in time: bodies of ``random_scenes`` without springs that fly at each other.

Energy, momenta and overlaps are told from the velocities, displacements and forms alone.
"""

import dataclasses

import numpy as np
import random_scenes as scenes
import ufl
from scene_oracle import matrix
from scipy.sparse import block_diag

import dolfinx_llm as llm

STEPS = 40
SPEED = 0.05  # of waves, at most


def draw(seed, second=False):
    """Scene of a seed, flat, drawn without overlaps, with neither springs nor moved supports."""
    scene, rng = scenes.draw(seed, second), np.random.default_rng([seed, 96])
    scene.walls, scene.radius, scene.load, scene.steps = "", 0.0, "force", [None] * STEPS
    closes = [c.law.ties and c.second[0] == "sphere" for c in scene.contacts]  # its gap at once
    both = zip(scene.contacts, closes, strict=True)
    scene.contacts = [c for c, at_once in both if not (c.moves or at_once)]
    if not scene.contacts:
        below = ("plane", np.zeros(scene.gdim), np.eye(scene.gdim)[-1])
        scene.contacts = [scenes.Contact((0, 0), below, llm.Frictionless())]
    levels = [(b.low, b.low + b.height) for b in scene.bodies]
    for contact in scene.contacts:
        below, second = contact.first[0], contact.second
        if second[0] == "plane":
            gap = abs(second[1][-1] - levels[0][0])
            gap = 0.0 if contact.law.ties else gap
            point = np.append(np.zeros(scene.gdim - 1), scene.bodies[0].low - gap)
            contact.second = ("plane", point, second[2])
        elif not isinstance(second[0], str):
            body, under = scene.bodies[second[0]], scene.bodies[below]
            gap = abs(levels[second[0]][0] - levels[below][1]) + abs(body.tilt)
            body.low = under.low + under.height + (0.0 if contact.law.ties else gap)
    for body in scene.bodies:
        body.E, body.spring = float(np.clip(body.E, 1e-2, 1e2)), 0.0
        body.n = (*body.n[:-1], 4)
    scene.dt = float(rng.choice([0.05, 0.1, 0.2]))
    scene.options = {"damping": float(rng.choice([0.0, 0.0, 0.1]))}
    scene.options["adaptive"] = 1e-3 if rng.random() < 0.3 else None
    return scene


@dataclasses.dataclass
class Flight:
    """A scene in time, and what its matrices say; density is 1 in the scene's units."""

    posed: scenes.Posed
    stepper: llm.TimeStepper

    @classmethod
    def of(cls, scene, variant=None, accepted=None, **kwargs):
        """With velocities, other ones for each body."""
        posed = scenes.pose(scene, variant, **kwargs)
        several, time = len(posed.forms) > 1, posed.length / np.sqrt(posed.modulus)
        solver = posed.variant.solver or scene.solver
        a, L = zip(*posed.forms, strict=True)
        stepper = llm.TimeStepper(
            1.0,
            a if several else a[0],
            L if several else L[0],
            dt=scene.dt * time,
            bcs=posed.bcs,
            interfaces=posed.interfaces,
            solver="saddle" if solver == "sparse" else solver,
            accepted=accepted,
            **scene.options,
        )
        posed.problem = stepper.problem
        v = np.zeros_like(posed.x)
        for k in range(len(scene.bodies)):
            own = np.random.default_rng([scene.seed, k]).uniform(-SPEED, SPEED, scene.gdim)
            own[-1] = -abs(own[-1]) * (k + (scene.base == "free"))
            v[posed.body == k] = own * (k > 0 or scene.base == "free")
        v[posed.held] = 0.0
        flight = cls(posed, stepper)
        for f, nodes in zip(flight.functions("v"), posed.nodes, strict=True):
            f.x.array[:] = (posed.length / time * v[nodes] @ posed.Q.T).ravel()
        return flight

    def functions(self, name):
        """Displacements or velocities, by the stepper's name."""
        found = getattr(self.stepper, name)
        return found if isinstance(found, list) else [found]

    def values(self, name):
        return np.concatenate([f.x.array for f in self.functions(name)])

    def matrices(self):
        """K and M of all bodies."""
        K = [matrix(a) for a, _ in self.posed.forms]
        of = zip(self.posed.spaces, self.stepper.density, strict=True)
        trials = [(rho, ufl.TrialFunction(V), ufl.TestFunction(V)) for V, rho in of]
        M = [matrix(rho * ufl.inner(u, w) * ufl.dx) for rho, u, w in trials]
        return block_diag(K).tocsr(), block_diag(M).tocsr()


def solve(scene, variant=None, watch=None, **kwargs):
    """Answers of all steps, as of ``random_scenes``; velocities follow from displacements."""
    flight, answers = Flight.of(scene, variant, **kwargs), []
    see = watch(flight.posed) if watch else lambda answer: None
    flight.stepper.start()
    for _ in scene.steps:
        flight.stepper.step()
        answers.append(scenes.collect(flight.posed))
        see(answers[-1])
    flight.stepper.problem.destroy()
    return answers


def drawn_apart(scene, contact):
    """Whether there is a gap between two bodies as drawn."""
    low, high = (scene.bodies[face[0]] for face in (contact.first, contact.second))
    return abs(high.low - low.low - low.height) > 1e-12


def check(scene, variant=None):
    """Nothing, and per step what is violated, {name: relative size}."""
    flight, found = Flight.of(scene, variant), []
    stepper, posed, gdim = flight.stepper, flight.posed, scene.gdim
    K, M = flight.matrices()
    x = [V.tabulate_dof_coordinates()[:, :gdim] / posed.length for V in posed.spaces]
    x = np.concatenate(x)
    stepper.start()

    def told():
        u, v = flight.values("u"), flight.values("v")
        p = (M @ v).reshape(-1, gdim)
        spin = x.T @ p
        return 0.5 * (v @ M @ v + u @ K @ u), np.vstack([p.sum(axis=0), spin - spin.T])

    energy, momenta = told()
    first, size = energy, np.abs(M @ flight.values("v")).sum()
    flies = scene.base == "free" and not any(isinstance(c.second[0], str) for c in scene.contacts)
    rubbing = [c for c in scene.contacts if getattr(c.law, "mu", 0.0)]
    rubs, apart = bool(rubbing), flies and any(drawn_apart(scene, c) for c in rubbing)
    for _ in scene.steps:
        stepper.step()
        before, (energy, now) = energy, told()
        worst = {"(energy with friction)" if rubs else "energy": (energy - before) / first}
        if flies:
            # Friction across a gap that was drawn has a moment in small deformation.
            worst["momenta"] = np.abs(now - momenta)[: 1 if apart else None].max() / size
        for contact, result in zip(scene.contacts, stepper.problem.results, strict=True):
            if contact.law.opens:
                worst["overlap"] = max(-s.frame_gap.min() / posed.length for s in result.sides)
        found.append({name: float(value) for name, value in worst.items()})
    stepper.problem.destroy()
    return [], found
