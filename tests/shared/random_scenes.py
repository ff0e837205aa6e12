"""Random scenes over the product: bodies, meshes, laws, supports, springs, units, load steps.

A ``Scene`` is drawn from a seed in its own unit system and position; a ``Variant`` says how it is
posed (turned, mirrored, sides swapped, nodes renumbered, other units). Answers of all variants are
brought back to the scene's own nodes and units, so that they can be compared.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import ufl
from dolfinx import fem, mesh
from mixed import mixed_space
from mpi4py import MPI
from scipy.spatial import cKDTree

import dolfinx_llm as llm
from dolfinx_llm import compat

NU = 0.3
HEX = "hexahedron"
KINDS = {2: ["quadrilateral", "triangle"], 3: [HEX, "tetrahedron"]}
TETS = [[0, 1, 3, 7], [0, 1, 5, 7], [0, 4, 5, 7], [0, 2, 3, 7], [0, 2, 6, 7], [0, 4, 6, 7]]
TRIANGLES = [[0, 1, 3], [0, 3, 2]]
BOTTOM, TOP, LEFT, RIGHT = range(4)  # faces of a body; its facet tag is 4 body + face + 1
APART = 3.0  # distance of the bodies in the reference configuration, where they are tagged


@dataclass
class Body:
    """A block: reference box [-1, 1]^(gdim - 1) x [0, 1], and where it is."""

    kind: str
    n: tuple  # cells in each direction
    half: float  # half the width
    shift: np.ndarray  # (gdim - 1,) of its middle
    low: float  # height of its lower face
    height: float
    tilt: float = 0.0  # of the lower face
    bulge: float = 0.0
    E: float = 1.0
    spring: float = 0.0  # volume springs over E
    jitter: float = 0.0
    order: int = 1  # of the displacement


@dataclass
class Contact:
    """An interface of the scene: faces (body, face), or an obstacle in the place of the second."""

    first: tuple
    second: object
    law: object
    moves: bool = False  # the obstacle follows the scene's motion


@dataclass
class Scene:
    """See ``draw``. Lengths are about 1, the moduli about 1."""

    seed: int
    gdim: int
    bodies: list
    contacts: list
    one_mesh: bool
    base: str  # support of body 0: "clamped", "free"
    load: str  # "motion" of the last body's top, "force" there, "obstacle": an obstacle moves
    steps: list  # (down, drag (gdim - 1,), turn, force) each
    solver: str
    length: float  # unit of length
    modulus: float  # unit of E
    Q: np.ndarray  # rotation in which it is posed
    walls: str = (
        ""  # lateral motion prescribed: "faces" (of all bodies' lateral faces), "all" nodes
    )
    radius: float = 0.0  # of the arch that the scene is bent to; 0: flat
    tool: bool = False  # all of the last body is moved, not its top alone
    notes: list = field(default_factory=list)

    def __str__(self):
        laws = [f"{c.law} {c.first}-{c.second}" for c in self.contacts]
        bodies = [
            f"{b.kind} P{b.order} {b.n} half {b.half:.2f} low {b.low:.3f} tilt {b.tilt:g} "
            f"bulge {b.bulge:g} E {b.E:.1e} spring {b.spring:.1e}"
            for b in self.bodies
        ]
        steps = [
            f"({d:.4f}, {np.round(g, 4).tolist()}, {t:.3f}, {f:.4f})" for d, g, t, f in self.steps
        ]
        return (
            f"seed {self.seed}: {self.gdim}D, {self.solver}, base {self.base}, load {self.load}, "
            f"length {self.length:.1e}, modulus {self.modulus:.1e}, one mesh {self.one_mesh}, "
            f"radius {self.radius:g} walls {self.walls}\n  "
            + "\n  ".join(bodies + laws + ["steps " + " ".join(steps)])
        )


@dataclass
class Variant:
    """How a scene is posed."""

    turn: object = None  # (gdim, gdim) orthogonal, on top of the scene's own; "random", "mirror"
    swap: bool = False  # sides of all interfaces
    renumber: int = 0  # seed; 0: as drawn
    length: float = 1.0  # units, on top of the scene's own
    modulus: float = 1.0
    solver: str = ""
    mixed: bool = False  # in mixed spaces, of which another block stands by itself

    def of(self, scene):
        """With the matrix that ``turn`` names, for this scene."""
        turn = self.turn
        if isinstance(turn, str):
            mirror = np.diag([-1.0] + [1.0] * (scene.gdim - 1))
            rng = np.random.default_rng([scene.seed, 13])
            turn = mirror if turn == "mirror" else rotation(rng, scene.gdim)
        return replace(self, turn=turn)


def rotation(rng, gdim):
    """Random rotation matrix."""
    Q, R = np.linalg.qr(rng.standard_normal((gdim, gdim)))
    Q = Q * np.sign(np.diag(R))
    Q[:, 0] *= np.sign(np.linalg.det(Q))
    return Q


def _axes(Q):
    """Signed permutation near an orthogonal matrix."""
    out, rest = np.zeros_like(Q), np.abs(Q)
    for _ in Q:
        i, j = np.unravel_index(rest.argmax(), rest.shape)
        out[i, j] = np.sign(Q[i, j])
        rest[i], rest[:, j] = -1.0, -1.0
    return out


def draw(seed, second=False):
    """Scene of a seed; with some bodies of second order, on straight frames."""
    rng = np.random.default_rng(seed)
    gdim = int(rng.choice([2, 3], p=[0.6, 0.4]))
    layout = str(rng.choice(["single", "tower", "table"], p=[0.2, 0.55, 0.25]))
    count = {"single": 1, "tower": int(rng.integers(2, 5)), "table": int(rng.integers(2, 5))}[
        layout
    ]
    if gdim == 3:
        count = min(count, 3)
    one_mesh = bool(rng.random() < 0.3)
    kinds = [str(k) for k in rng.choice(KINDS[gdim], count)]
    kinds = [kinds[0]] * count if one_mesh else kinds
    ratio = rng.random() < 0.35
    moduli = 10.0 ** rng.uniform(-3.0, 3.0, count) if ratio else np.ones(count)
    scene = Scene(
        seed, gdim, [], [], one_mesh,
        base=str(rng.choice(["clamped", "free"], p=[0.75, 0.25])),
        load=str(rng.choice(["motion", "force", "obstacle"], p=[0.55, 0.25, 0.2])),
        steps=[],
        solver=str(rng.choice(["auto", "saddle", "condensed", "sparse"])),
        length=float(10.0 ** rng.uniform(-3, 3)) if rng.random() < 0.6 else 1.0,
        modulus=float(10.0 ** rng.uniform(0, 11)) if rng.random() < 0.6 else 1.0,
        Q=rotation(rng, gdim) if rng.random() < 0.5 else np.eye(gdim),
    )  # fmt: skip
    _bodies(scene, rng, layout, kinds, moduli)
    _obstacles(scene, rng, layout)
    _springs(scene, rng, layout)
    _steps(scene, rng)
    if seed % 8 == 5 and not scene.radius:
        _walls(scene, np.random.default_rng([seed, 99]))
    if second:
        _orders(scene, np.random.default_rng([seed, 98]))
    return scene


def _orders(scene, rng):
    """Most bodies of second order; those on one mesh have one order."""
    scene.radius = 0.0
    orders = rng.choice([1, 2], len(scene.bodies), p=[0.3, 0.7])
    for body, order in zip(scene.bodies, orders, strict=True):
        body.order = 2 if scene.one_mesh else int(order)
        body.n = tuple(min(n, 5 if scene.gdim == 2 else 3) for n in body.n)


def _walls(scene, rng):
    """Lateral supports of all bodies, which end at the interfaces from both sides."""
    scene.walls = str(rng.choice(["faces", "all"]))
    scene.Q = np.eye(scene.gdim)
    scene.steps = [(down, 0.0 * drag, 0.0, force) for down, drag, _, force in scene.steps]
    for body in scene.bodies:
        body.shift = 0.0 * body.shift if scene.walls == "faces" else body.shift


def _law(rng, tied=0.3):
    name = rng.choice(["tied", "frictionless", "coulomb"], p=[tied, 0.3, 0.7 - tied])
    if name == "tied":
        return llm.Tied(close_gap=bool(rng.random() < 0.3))
    if name == "frictionless":
        return llm.Frictionless()
    return llm.Coulomb(float(rng.choice([0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 1.5])))


def _cells(rng, gdim):
    n = int(rng.integers(2, 9 if gdim == 2 else 5))
    return (
        (n, int(rng.integers(1, 4)))
        if gdim == 2
        else (n, max(1, n + int(rng.integers(-1, 2))), int(rng.integers(1, 3)))
    )


def _bodies(scene, rng, layout, kinds, moduli):
    gdim, count = scene.gdim, len(kinds)
    jitter = 0.2 * float(rng.random() < 0.6)
    level = 0.0
    for k in range(count):
        half, shift = 1.0, np.zeros(gdim - 1)
        law, gap = None, 0.0
        if k:
            law = _law(rng)
            gap = float(rng.choice([0.0, 0.0, 0.0, 0.02, -0.02, 1e-3]))
            if isinstance(law, llm.Tied):
                gap *= 0.2
        if k and layout == "tower":
            half = float(rng.uniform(0.5, 1.0))
            shift = rng.uniform(-0.3, 0.3, gdim - 1) * float(rng.random() < 0.5)
        if k and layout == "table":
            half = 0.85 / (count - 1) * float(rng.uniform(0.6, 0.95))
            shift[0] = -1.0 + (2 * k - 1) / (count - 1) if count > 2 else 0.3 * rng.uniform(-1, 1)
        height = float(rng.uniform(0.5, 1.0))
        body = Body(
            kinds[k],
            _cells(rng, gdim),
            half,
            shift,
            level + gap,
            height,
            E=float(moduli[k]),
            jitter=jitter,
        )
        if k and not isinstance(law, llm.Tied) and rng.random() < 0.25:
            body.tilt = float(rng.uniform(-0.03, 0.03))
            body.bulge = float(rng.choice([0.0, 0.05]))
        scene.bodies.append(body)
        if k:
            below = 0 if layout == "table" else k - 1
            scene.contacts.append(Contact((below, TOP), (k, BOTTOM), law))
        level = level + gap + height if layout == "tower" or k == 0 else level
    if layout == "tower" and count > 1 and rng.random() < 0.12:
        scene.radius = float(rng.uniform(2.5, 5.0))


def _obstacles(scene, rng, layout):
    """Floor below a free base, and what presses from above."""
    gdim = scene.gdim
    bottom, top = scene.bodies[0], scene.bodies[-1]
    if scene.radius:
        scene.base = "clamped"
        scene.load = "motion" if scene.load == "obstacle" else scene.load
    if layout == "single":
        scene.base = "clamped" if scene.load == "obstacle" else "free"
    if scene.base == "free":
        gap = float(rng.choice([0.0, 0.0, 0.01, -0.01]))
        point, normal = np.zeros(gdim), np.eye(gdim)[-1]
        point[-1] = bottom.low - gap
        floor = ("plane", point, normal)
        if rng.random() < 0.3:  # bowl below
            R = float(rng.uniform(3.0, 8.0))
            centre = point.copy()
            centre[-1] += -R
            kind = "sphere" if gdim == 2 or rng.random() < 0.5 else "cylinder"
            floor = (kind, centre, R)
        scene.contacts.append(Contact((0, BOTTOM), floor, _law(rng, 0.15)))
    if scene.load == "obstacle":
        gap = float(rng.choice([0.0, 0.0, 0.01]))
        point = np.zeros(gdim)
        point[:-1] = top.shift
        point[-1] = top.low + top.height + gap
        kind = str(
            rng.choice(["plane", "sphere", "cylinder"] if gdim == 3 else ["plane", "sphere"])
        )
        if kind == "plane":
            press = ("plane", point, -np.eye(gdim)[-1])
        else:
            R = float(rng.uniform(0.7, 4.0))
            point[-1] += R
            press = (kind, point, R)
        scene.contacts.append(
            Contact((len(scene.bodies) - 1, TOP), press, _law(rng, 0.15), moves=True)
        )


def _springs(scene, rng, layout):
    """Bodies that nothing prescribed or tied holds hang on springs; weak ones only where they are
    not pushed aside."""
    held = {0} if scene.base == "clamped" else set()
    if scene.load == "motion":
        held.add(len(scene.bodies) - 1)
    ties = [c for c in scene.contacts if isinstance(c.law, llm.Tied)]
    for c in ties:
        if isinstance(c.second[0], str):
            held.add(c.first[0])
    for _ in scene.bodies:
        for c in ties:
            pair = {c.first[0], c.second[0]} if not isinstance(c.second[0], str) else set()
            if pair & held:
                held |= pair
    skew = (
        scene.radius > 0
        or any(b.tilt or b.bulge or np.any(b.shift) for b in scene.bodies)
        or any(isinstance(c.second[0], str) and c.second[0] != "plane" for c in scene.contacts)
    )
    for k, body in enumerate(scene.bodies):
        if k not in held:
            weakest = -2.0 if skew else -12.0
            body.spring = float(10.0 ** rng.uniform(weakest, 0.0))
        elif rng.random() < 0.1:
            body.spring = float(10.0 ** rng.uniform(-12.0, 0.0))


def _steps(scene, rng):
    """Press, drag, lift or turn back."""
    weak = min([b.spring for b in scene.bodies if b.spring], default=1.0) < 1e-3
    gap = 0.02 if any(b.low for b in scene.bodies) else 0.0
    down = gap + float(rng.uniform(0.005, 0.04))
    drag = rng.uniform(-0.03, 0.03, scene.gdim - 1)
    turn = float(rng.uniform(-0.02, 0.02)) * float(not weak and rng.random() < 0.4)
    force = float(rng.uniform(0.005, 0.03)) * min(b.E for b in scene.bodies)
    zero = 0.0 * drag
    if scene.load == "force" and weak:
        drag = zero
    last = str(rng.choice(["lift", "back", "turn"]))
    scene.steps = [(down, zero, 0.0, force), (down, drag, turn, force)]
    scene.steps.append(
        {
            "lift": (-0.5 * down, drag, turn, 0.1 * force),
            "back": (down, -0.5 * drag, turn, force),
            "turn": (down, drag, -turn, 0.5 * force),
        }[last]
    )


# From a scene to a problem


def _grid(body, k, rng):
    """Reference points (body k apart from the others) and cells."""
    gdim = len(body.n)
    axes = [np.linspace(-1.0, 1.0, n + 1) for n in body.n[:-1]] + [
        np.linspace(0.0, 1.0, body.n[-1] + 1)
    ]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    number = np.arange(x[..., 0].size).reshape(x.shape[:-1])
    x = x.reshape(-1, gdim)
    if body.jitter:
        inner = (np.abs(x[:, :-1]) < 1.0 - 1e-9).all(axis=1)
        lateral = np.unique(np.round(x[:, :-1], 9), axis=0, return_inverse=True)[1].ravel()
        shake = rng.uniform(-body.jitter, body.jitter, (lateral.max() + 1, gdim - 1))
        x[:, :-1] += 2.0 * (shake / np.array(body.n[:-1]))[lateral] * inner[:, None]
    corners = []
    for c in range(2**gdim):
        cut = tuple(slice(c >> d & 1, n + (c >> d & 1)) for d, n in enumerate(body.n))
        corners.append(number[cut].ravel())
    cells = np.stack(corners, axis=1)
    if body.kind == "tetrahedron":
        cells = cells[:, TETS].reshape(-1, 4)
    elif body.kind == "triangle":
        cells = cells[:, TRIANGLES].reshape(-1, 3)
    x[:, -1] += APART * k
    return x, cells


def _middles(kind, cells):
    """Corners (n, 2 or more) between which a second-order body's other nodes lie, per number."""
    gdim = 2 if kind in KINDS[2] else 3
    if kind in ("triangle", "tetrahedron"):
        own = [[(i, j) for j in range(gdim + 1) for i in range(j)]]
    else:  # faces of 1, 2, ... dimensions: corners that share the other bits
        own = [[], [], []][:gdim]
        for axes in range(1, 2**gdim):
            free = [c for c in range(2**gdim) if c & ~axes == 0]
            for low in (c for c in range(2**gdim) if c & axes == 0):
                own[len(free).bit_length() - 2].append(tuple(low | c for c in free))
    return [np.unique(np.sort(cells[:, k].reshape(-1, len(k[0])), axis=1), axis=0) for k in own]


def place(scene, p):
    """Scene positions (n, gdim) of reference positions (n, gdim)."""
    out = np.array(p)
    which = np.floor(p[:, -1] / APART + 0.1).astype(int)
    for k, body in enumerate(scene.bodies):
        on = which == k
        z = p[on, -1] - APART * k
        lateral = body.half * p[on, :-1]
        drop = (1.0 - z) * (body.tilt * p[on, 0] + body.bulge * p[on, 0] ** 2)
        out[on, :-1] = lateral + body.shift
        out[on, -1] = body.low + z * body.height + drop
    if scene.radius:
        R, s, z = scene.radius, out[:, 0].copy(), out[:, -1].copy()
        out[:, 0] = (R + z) * np.sin(s / R)
        out[:, -1] = (R + z) * np.cos(s / R) - R
    return out


@dataclass
class Posed:
    """A scene as a ContactProblem, with what the oracle needs."""

    scene: Scene
    variant: Variant
    Q: np.ndarray
    length: float
    modulus: float
    spaces: list
    nodes: list  # per mesh (n,) the scene's number of each node of this rank's dofs
    body: np.ndarray  # (all nodes,) body of each of the scene's nodes, corners of cells first
    x: np.ndarray  # (all nodes, gdim) the scene's positions
    forms: list  # (a, L) per mesh
    bcs: list
    interfaces: list
    motion: object  # Function of the prescribed top, or None
    force: object  # Constant, or None
    obstacles: list
    problem: object = None
    faces: dict = field(default_factory=dict)  # (body, face): the scene's nodes on it
    residuals: list = field(default_factory=list)  # compiled, at finite deformation
    held: object = None  # (all nodes, gdim) whether the scene's components are prescribed
    within: list = field(default_factory=list)  # per mesh, of a mixed space: the dofs of ``spaces``

    def vector(self, v):
        """Vector of the scene, posed."""
        return self.Q @ np.asarray(v)

    @property
    def solver(self):
        """That is asked for; "condensed" is refused for mixed spaces."""
        solver = self.variant.solver or self.scene.solver
        return "saddle" if self.variant.mixed and solver == "condensed" else solver

    def make(self):
        """The ContactProblem; it may raise."""
        solver, options = self.solver, {}
        if solver == "sparse":
            solver = "saddle"
        several = len(self.forms) > 1
        a, L = [f[0] for f in self.forms], [f[1] for f in self.forms]
        self.problem = llm.ContactProblem(
            a if several else a[0],
            L if several else L[0],
            bcs=self.bcs,
            interfaces=self.interfaces,
            solver=solver,
            **options,
        )
        if self.solver == "sparse" and self.problem.form == "flexibility":
            method = self.problem.method
            method.renew(replace(method.setting, form="saddle"))
        return self.problem

    def set_step(self, step):
        """Loads of a load step."""
        down, drag, turn, force = step
        gdim, scale = self.scene.gdim, self.length
        if self.motion is not None:
            mine = self.nodes[self.last_mesh]
            x = self.x[mine]
            move = np.zeros((len(mine), gdim))
            move[:, :-1] = drag
            move[:, -1] = -down + turn * x[:, 0]
            n = len(mine) * gdim
            self.motion.x.array[:n] = (scale * move @ self.Q.T).ravel()[:n]
        if self.force is not None:
            t = np.zeros(gdim)
            t[:-1] = 0.05 * force * np.sign(drag)
            t[-1] = -force
            self.force.value[:] = self.modulus * self.vector(t)
        for obstacle in self.obstacles:
            t = np.append(drag, -down)
            obstacle.displacement = tuple(scale * self.vector(t))

    @property
    def last_mesh(self):
        return 0 if self.scene.one_mesh else len(self.scene.bodies) - 1


def pose(scene, variant=None, comm=MPI.COMM_SELF):
    """Meshes, forms, conditions and interfaces of a scene."""
    variant = variant or Variant()
    gdim = scene.gdim
    Q = scene.Q if variant.turn is None else np.asarray(variant.turn) @ scene.Q
    if scene.walls:  # which are components: the axes that are nearest
        Q = _axes(Q)
    length, modulus = scene.length * variant.length, scene.modulus * variant.modulus
    rng = np.random.default_rng([scene.seed, 7])
    grids = [_grid(body, k, rng) for k, body in enumerate(scene.bodies)]
    first = np.cumsum([0] + [len(x) for x, _ in grids])
    body_of = np.repeat(np.arange(len(grids)), np.diff(first))
    reference = np.concatenate([x for x, _ in grids])
    x_scene = place(scene, reference)
    between = [
        first[k] + corners
        for k, body in enumerate(scene.bodies)
        if body.order > 1
        for corners in _middles(body.kind, grids[k][1])
    ]
    body_of = np.concatenate([body_of, *(body_of[c[:, 0]] for c in between)])
    x_scene = np.concatenate([x_scene, *(x_scene[c].mean(axis=1) for c in between)])
    reference = np.concatenate([reference, *(reference[c].mean(axis=1) for c in between)])
    groups = [list(range(len(grids)))] if scene.one_mesh else [[k] for k in range(len(grids))]
    shuffle = np.random.default_rng(variant.renumber) if variant.renumber else None
    posed = Posed(
        scene, variant, Q, length, modulus, [], [], body_of, x_scene, [], [], [], None, None, []
    )
    for k in range(len(grids)):
        for face, at in ((BOTTOM, 0.0), (TOP, 1.0)):
            on = (body_of == k) & np.isclose(reference[:, -1], APART * k + at)
            posed.faces[k, face] = np.flatnonzero(on)
    tags, reached = [], []
    for group in groups:
        x = np.concatenate([grids[k][0] for k in group])
        start = first[group[0]]
        cells = np.concatenate([grids[k][1] + first[k] - start for k in group])
        number = start + np.arange(len(x))
        if shuffle is not None:
            order = shuffle.permutation(len(x))
            inverse = np.argsort(order)
            x, number, cells = x[order], number[order], inverse[cells]
            cells = cells[shuffle.permutation(len(cells))]
        if comm.rank:
            x, cells = x[:0], cells[:0]
        domain = compat.create_mesh(comm, cells, x, scene.bodies[group[0]].kind)
        order = scene.bodies[group[0]].order
        if variant.mixed:
            W = mixed_space(domain, ("Lagrange", order, True), ("DG", 0, False))
            V, within = W.sub(0).collapse()
            posed.within.append(np.ravel(np.asarray(within, dtype=np.int64)))
        else:
            W = V = compat.function_space(domain, degree=order, shape=(gdim,))
        given = number[np.asarray(domain.geometry.input_global_indices, dtype=np.int64)]
        of_dof = np.zeros(0, dtype=int)
        if len(points := V.tabulate_dof_coordinates()[:, :gdim]):
            distance, of_dof = cKDTree(reference).query(points)
            assert distance.max() < 1e-9, "a dof that is no node of the scene"
        tags.append(_tags(domain, scene, group, posed, len(tags)))
        reached.append((W, _held(W, V, scene, group, posed.Q)))
        posed.spaces.append(V)
        posed.nodes.append(of_dof)
        domain.geometry.x[:, :gdim] = length * x_scene[given] @ Q.T
        posed.forms.append(_forms(W, domain, scene, group, posed, tags[-1], given))
    _conditions(scene, posed, reached)
    _interfaces(scene, posed, tags)
    return posed


def _tags(domain, scene, group, posed, index):
    gdim = scene.gdim
    found, values = [], []
    for k in group:
        for face, axis, at in (
            (BOTTOM, gdim - 1, APART * k), (TOP, gdim - 1, APART * k + 1.0),
        ):  # fmt: skip
            facets = mesh.locate_entities_boundary(
                domain, gdim - 1, lambda p, axis=axis, at=at: np.isclose(p[axis], at)
            )
            found.append(facets)
            values.append(np.full(len(facets), 4 * k + face + 1, dtype=np.int32))
    facets, values = np.concatenate(found), np.concatenate(values)
    order = np.argsort(facets, kind="stable")
    return mesh.meshtags(domain, gdim - 1, facets[order].astype(np.int32), values[order])


def _held(W, V, scene, group, Q):
    """Dofs of the clamped base, of the top that is moved and of walls, found in the reference
    positions; of a mixed space those of W's first block and of V."""
    held, spaces = {}, V if W is V else (W.sub(0), V)

    def at(height):
        return fem.locate_dofs_geometrical(spaces, lambda p: np.isclose(p[scene.gdim - 1], height))

    if scene.base == "clamped" and 0 in group:
        held["base"] = at(0.0)
    last = len(scene.bodies) - 1
    if scene.load == "motion" and last in group:
        held["top"] = at(APART * last + 1.0)
        if scene.tool:
            held["top"] = fem.locate_dofs_geometrical(
                spaces, lambda p: p[scene.gdim - 1] > APART * last - 0.5
            )
    domain = V.mesh
    for j in range(scene.gdim - 1) if scene.walls else ():
        c = int(np.abs(Q[:, j]).argmax())  # walls: Q permutes the axes
        dim = domain.topology.dim - (scene.walls == "faces")
        domain.topology.create_connectivity(dim, domain.topology.dim)
        if scene.walls == "faces":
            facets = mesh.locate_entities_boundary(
                domain, dim, lambda p, j=j: np.isclose(np.abs(p[j]), 1.0)
            )
        else:
            facets = np.arange(domain.topology.index_map(dim).size_local, dtype=np.int32)
        held[j, c] = [
            fem.locate_dofs_topological(U.sub(c), dim, facets)
            for U in ([V] if W is V else [W.sub(0), V])
        ]
    return held


def _cell_body(domain, posed, given):
    """DG0 marks: body of each cell."""
    nodes = compat.cell_dofs(domain.geometry)
    return posed.body[given[nodes[:, 0]]]


def parted(posed, u, w, E):
    """Displacements of u and w, and forms of what else there is in mixed spaces, which stands by
    itself."""
    if not posed.variant.mixed:
        return u, w, []
    (u, *q), (w, *r) = ufl.split(u), ufl.split(w)
    return u, w, [-b * c / E * ufl.dx for b, c in zip(q, r, strict=True)]


def _forms(V, domain, scene, group, posed, tags, given):
    """Linear elasticity with volume springs; constants are coefficients, so that one kind of cell
    is compiled once."""
    W = compat.function_space(domain, "DG", 0)
    E, k = fem.Function(W), fem.Function(W)
    bodies = _cell_body(domain, posed, given)
    column = compat.cell_dofs(W)[: len(bodies)].ravel()
    moduli = np.array([b.E for b in scene.bodies])[bodies] * posed.modulus
    springs = np.array([b.E * b.spring for b in scene.bodies])[bodies]
    E.x.array[column] = moduli
    k.x.array[column] = springs * posed.modulus / posed.length**2
    u, w, others = parted(posed, ufl.TrialFunction(V), ufl.TestFunction(V), E)
    eps = ufl.sym(ufl.grad(u))
    mu, lam = E / (2 * (1 + NU)), E * NU / (1 + NU) / (1 - 2 * NU)
    stress = 2 * mu * eps + lam * ufl.tr(eps) * ufl.Identity(scene.gdim)
    a = sum(others, ufl.inner(stress, ufl.grad(w)) * ufl.dx + k * ufl.inner(u, w) * ufl.dx)
    load = fem.Constant(domain, np.zeros(scene.gdim))
    last = len(scene.bodies) - 1
    if scene.load == "force" and last in group:
        posed.force = load
        top = tags.find(4 * last + TOP + 1)
        # The number of the tag is compiled in: 1 in all scenes.
        ones = mesh.meshtags(domain, tags.dim, top, np.ones(len(top), dtype=np.int32))
        L = ufl.inner(load, w) * ufl.Measure("ds", domain=domain, subdomain_data=ones)(1)
    else:
        L = ufl.inner(load, w) * ufl.dx
    return a, L


def _conditions(scene, posed, reached):
    posed.held = np.zeros(posed.x.shape, dtype=bool)
    for V, nodes, (W, held) in zip(posed.spaces, posed.nodes, reached, strict=True):
        whole = W is V
        block, bs = V if whole else W.sub(0), 1 if whole else scene.gdim
        for name, dofs in held.items():
            if isinstance(name, tuple):
                posed.bcs.append(fem.dirichletbc(0.0, dofs[0], block.sub(name[1])))
                posed.held[nodes[dofs[-1] // scene.gdim], name[0]] = True
                continue
            value = fem.Function(V)
            given = (value, dofs) if whole else (value, dofs, block)
            posed.bcs.append(fem.dirichletbc(*given))
            posed.held[nodes[(dofs if whole else dofs[1]) // bs]] = True
            if name == "top":
                posed.motion = value


def _interfaces(scene, posed, tags):
    gdim = scene.gdim

    def side(face):
        i = 0 if scene.one_mesh else face[0]
        return (tags[i], 4 * face[0] + face[1] + 1)

    for contact in scene.contacts:
        if isinstance(contact.second[0], str):
            second = _rigid(contact.second, posed, gdim)
            if contact.moves:
                posed.obstacles.append(second)
        else:
            second = side(contact.second)
        sides = (side(contact.first), second)
        sides = sides[::-1] if posed.variant.swap else sides
        posed.interfaces.append(llm.Interface(None, sides, law=contact.law))


def _rigid(what, posed, gdim):
    kind, point, value = what
    point = posed.length * posed.vector(point)
    if kind == "plane":
        return llm.RigidPlane(point, posed.vector(value))
    if kind == "sphere":
        return llm.RigidSphere(point, posed.length * value)
    return llm.RigidCylinder(point, posed.vector([0.0, 1.0, 0.0]), posed.length * value)


# Answers, in the scene's own nodes, directions and units


@dataclass
class Answer:
    """One load step."""

    u: np.ndarray  # (all nodes, gdim) [scene's length]
    force: list  # per interface and body side (all nodes, gdim) forces that the body exerts
    part: list  # the same (all nodes,): nodes that take part
    results: list  # per interface: frame quantities as reported


def collect(posed, result=None):
    """Answer of the last solve, the same on every rank."""
    problem, scene = posed.problem, posed.scene
    comm = posed.spaces[0].mesh.comm
    gdim = scene.gdim
    functions = problem.u if isinstance(problem.u, list) else [problem.u]
    u = np.zeros((len(posed.x), gdim))
    within = posed.within or [slice(None)] * len(functions)
    for f, V, nodes, own in zip(functions, posed.spaces, posed.nodes, within, strict=True):
        n = V.dofmap.index_map.size_local
        rows = np.column_stack([nodes[:n], f.x.array[own][: n * gdim].reshape(n, gdim)])
        rows = np.concatenate(comm.allgather(rows))
        u[rows[:, 0].astype(int)] = rows[:, 1:]
    u = u @ posed.Q / posed.length
    forces, parts = [], []
    unit = posed.modulus * posed.length ** (gdim - 1)
    for contact, result in zip(scene.contacts, problem.results, strict=True):
        faces = [contact.first]
        if not isinstance(contact.second[0], str):
            faces.append(contact.second)
        sides = list(result.sides)
        if posed.variant.swap and len(sides) == 2:
            sides = sides[::-1]
        for face, side in zip(faces, sides, strict=True):
            full = np.zeros((len(posed.x), gdim))
            at = face_nodes(posed, face, side.drawn)
            full[at] = side.force @ posed.Q / unit
            forces.append(full)
            parts.append(np.isin(np.arange(len(full)), at))
    return Answer(u, forces, parts, list(problem.results))


def face_nodes(posed, face, x):
    """Scene's numbers of a face's nodes at positions x (n, gdim) as posed."""
    mine = np.flatnonzero(posed.body == face[0])
    distance, at = cKDTree(posed.x[mine]).query(x @ posed.Q / posed.length)
    assert distance.max(initial=0.0) < 1e-9, "a side's node that is no node of the body"
    return mine[at]


def solve(scene, variant=None, comm=MPI.COMM_SELF, watch=None):
    """Answers of all load steps; what ``watch(posed)`` returns is called with each."""
    posed = pose(scene, variant, comm)
    posed.make()
    return answers_of(posed, watch)


def answers_of(posed, watch=None, **options):
    """The same of a scene that is posed, with options of ``solve``."""
    answers, see = [], watch(posed) if watch else lambda answer: None
    for step in posed.scene.steps:
        posed.set_step(step)
        posed.problem.solve(**options)
        answers.append(collect(posed))
        see(answers[-1])
    posed.problem.destroy()
    return answers


def differences(found, known, scene):
    """Largest relative differences of forces and u over all steps; of u also what of it exceeds
    the motion that rounding leaves to a body on weak springs."""
    size_u = max(np.abs(a.u).max() for a in known)
    size_u = max([size_u, *(1e-3 * abs(s[0]) for s in scene.steps if s)])  # nothing touches
    least = 1e-3 * size_u * min(b.E for b in scene.bodies)  # nothing touches: rounding
    size_f = max([np.abs(f).max() for a in known for f in a.force] + [least])
    steps = list(zip(found, known, strict=True))
    du = max(np.abs(a.u - b.u).max() for a, b in steps)
    df = max(np.abs(f - g).max() for a, b in steps for f, g in zip(a.force, b.force, strict=True))
    weakest = min([b.spring for b in scene.bodies if b.spring], default=1.0)
    ratio = max(b.E for b in scene.bodies) / min(b.E for b in scene.bodies)
    return {"u": du / size_u, "force": df / size_f, "allowed u": 1e-14 * ratio / weakest}
