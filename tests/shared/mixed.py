"""Two blocks of an incompressible, or nearly incompressible, material on each other: (u, p)."""

import numpy as np
import second_order_blocks as so
import ufl
from dolfinx import fem
from scenes import squares

import dolfinx_llm as llm

MU = 1000.0
BOXES = {
    2: (((0, 0), (0, 1)), ((1, 1), (1, 2))),
    3: (((0, 0, 0), (0, 0, 1)), ((1, 1, 1), (1, 1, 2))),
}


TAYLOR_HOOD = ("Lagrange", 2, True), ("Lagrange", 1, False)


def mixed_space(mesh, *blocks):
    """Mixed space of blocks, (family, degree, whether a vector) each."""
    gdim = mesh.geometry.dim
    kind = mesh.ufl_cell()
    try:
        from basix.ufl import element, mixed_element
    except ImportError:
        elements = [
            (ufl.VectorElement if vector else ufl.FiniteElement)(family, kind, degree)
            for family, degree, vector in blocks
        ]
        return fem.FunctionSpace(mesh, ufl.MixedElement(elements))
    elements = [
        element(family, mesh.basix_cell(), degree, **({"shape": (gdim,)} if vector else {}))
        for family, degree, vector in blocks
    ]
    return fem.functionspace(mesh, mixed_element(elements))


class Field:
    """A displacement without divergence and a pressure: quadratic and linear, or waves."""

    def __init__(self, gdim, waves, seed=31):
        rng = np.random.default_rng(seed)
        self.waves, self.k = waves, rng.uniform(0.8, 1.6, (gdim, gdim))
        self.a = rng.uniform(-1.0, 1.0, (gdim, gdim))
        along = np.einsum("ij,ij->i", self.a, self.k) / np.einsum("ij,ij->i", self.k, self.k)
        self.a = 0.01 * (self.a - along[:, None] * self.k)
        self.phase, self.q = rng.uniform(0.0, 2.0, gdim), rng.uniform(0.8, 1.6, gdim)

    def __call__(self, x):
        """Displacement at NumPy coordinates x (gdim or more, n)."""
        s = self.k @ x[: len(self.k)] + self.phase[:, None]
        return self.a.T @ (np.sin(s) if self.waves else s**2)

    def pressure(self, x):
        s = self.q @ x[: len(self.q)]
        return 10.0 * (np.cos(s) if self.waves else 1.0 + s)

    def expressions(self, domain):
        """Displacement and pressure in UFL."""
        x = ufl.SpatialCoordinate(domain)
        s = [
            sum(float(c) * x[j] for j, c in enumerate(k)) + float(b)
            for k, b in zip(self.k, self.phase)
        ]
        h = [ufl.sin(t) if self.waves else t**2 for t in s]
        u = ufl.as_vector([sum(float(a) * t for a, t in zip(row, h)) for row in self.a.T])
        t = sum(float(c) * x[j] for j, c in enumerate(self.q))
        return u, 10.0 * (ufl.cos(t) if self.waves else 1.0 + t)

    def stress(self, x):
        """(n, gdim, gdim) at points x (n, gdim)."""
        s = x @ self.k.T + self.phase
        slope = np.cos(s) if self.waves else 2.0 * s
        grad = np.einsum("nm,mi,mj->nij", slope, self.a, self.k)
        p = self.pressure(x.T)[:, None, None] * np.eye(x.shape[1])
        return MU * (grad + grad.transpose(0, 2, 1)) - p


def stress(u, p):
    return 2.0 * MU * ufl.sym(ufl.grad(u)) - p * ufl.Identity(len(u))


def problem(vectors, tags, field, nu, interface=None, **options):
    """Two tied blocks with the answer ``field``, prescribed on the first bottom and the last top,
    with its body forces, and its tractions at the other sides; p = -λ (div u - g)."""
    compliance = (1.0 - 2.0 * nu) / (2.0 * MU * nu)
    forms, loads, bcs, spaces = [], [], [], []
    for V, own in zip(vectors, tags, strict=True):
        domain, gdim = V.mesh, V.mesh.geometry.dim
        W = mixed_space(domain, *TAYLOR_HOOD)
        (u, p), (w, q) = ufl.TrialFunctions(W), ufl.TestFunctions(W)
        c = fem.Constant(domain, compliance)
        a = ufl.inner(stress(u, p), ufl.grad(w)) - q * ufl.div(u) - c * p * q
        exact, pressure = field.expressions(domain)
        ds = ufl.Measure("ds", domain=domain, subdomain_data=own)
        outer = ufl.inner(stress(exact, pressure) * ufl.FacetNormal(domain), w)
        body = -ufl.inner(ufl.div(stress(exact, pressure)), w) - c * pressure * q
        forms.append(a * ufl.dx)
        loads.append(body * ufl.dx + outer * ds(so.LATERAL))
        known = fem.Function(W.sub(0).collapse()[0])
        known.interpolate(field)
        at = np.concatenate([own.find(tag) for tag in (so.BOTTOM[0], so.TOP[1])]).astype(np.int32)
        pair = W.sub(0), known.function_space
        dofs = fem.locate_dofs_topological(pair, gdim - 1, np.sort(at))
        bcs.append(fem.dirichletbc(known, dofs, W.sub(0)))
        spaces.append(W)
    sides = (2, 3) if len(tags) == 1 else ((tags[0], 2), (tags[1], 3))
    chosen = [llm.Interface(tags[0], sides, **(interface or {}))]
    one = len(spaces) == 1
    forms, loads = (forms[0], loads[0]) if one else (forms, loads)
    return llm.ContactProblem(forms, loads, bcs=bcs, interfaces=chosen, **options)


def errors(found, field):
    """Relative L2 errors of u, its gradient, and p of a solution, or of several."""
    sums = np.zeros((3, 2))
    for w in found if isinstance(found, list) else [found]:
        domain = w.function_space.mesh
        u, p = ufl.split(w)
        exact, pressure = field.expressions(domain)
        both = u - exact, exact
        terms = *both, *map(ufl.grad, both), p - pressure, pressure
        sums += squares(domain, terms, 6).reshape(sums.shape)
    return np.sqrt(sums[:, 0] / sums[:, 1])


def nonlinear(a, L, *, solver, **chosen):
    """The same bodies as of a residual form, at finite deformation."""
    w = fem.Function(a.arguments()[0].ufl_function_space())
    return llm.NonlinearContactProblem(ufl.action(a, w) - L, w, **chosen)


def pressed(law, blocks, comm, solver="auto", make=llm.ContactProblem, spring=0.0, given=None):
    """A block dragged along a larger one, lifted at one end and pressed at the other; ν = 0.3. A
    ``spring`` holds it in the place of the condition that drags it. Functions of the conditions are
    added to the list ``given``.

    Where the pressures of a mixed space contain the divergences, it is the plain problem."""
    low, high = (BOXES[2][0][0], (0.137, 1)), BOXES[2][1]
    (V,), (own,) = so.blocks(comm, ("triangle", "triangle"), (5, 7), low, high)
    lame, x = 1500.0, ufl.SpatialCoordinate(V.mesh)
    ds = ufl.Measure("ds", domain=V.mesh, subdomain_data=own)
    if blocks is None:
        W, u, w = V, ufl.TrialFunction(V), ufl.TestFunction(V)
        part, volume = V, lame * ufl.div(u) * ufl.div(w)
    else:
        W = mixed_space(V.mesh, *blocks)
        (p, u), (q, w), part = ufl.TrialFunctions(W), ufl.TestFunctions(W), W.sub(1)
        volume = -p * ufl.div(w) - q * ufl.div(u) - p * q / lame
    a = (2 * so.MU * ufl.inner(ufl.sym(ufl.grad(u)), ufl.grad(w)) + volume) * ufl.dx
    bcs, held = [], [(part, so.BOTTOM[0], 0.0), (part.sub(0), so.TOP[1], 0.004)]
    if spring:
        a, held = a + spring * ufl.inner(u, w) * ds(so.TOP[1]), held[:1]
    for space, tag, value in held:
        known = fem.Function(V if space is V else space.collapse()[0])
        known.x.array[:] = value
        if given is not None:
            given.append(known)
        if space is V:
            bcs.append(fem.dirichletbc(known, fem.locate_dofs_topological(V, 1, own.find(tag))))
        else:
            both = space, known.function_space
            dofs = fem.locate_dofs_topological(both, 1, own.find(tag))
            bcs.append(fem.dirichletbc(known, dofs, space))
    L = (60.0 - 160.0 * x[0]) * w[1] * ds(so.TOP[1])
    interface = llm.Interface(own, (2, 3), law=law)
    return make(a, L, bcs=bcs, interfaces=[interface], solver=solver)
