"""What is said of a solution: bodies that move away, springs of any size, rounding."""

import contextlib
import logging

import contact_scenes as scenes
import numpy as np
import pairs
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI
from sampling import drawn, some_of
from scenes import hold
from scipy.sparse import csr_matrix
from stacked import Stack

import dolfinx_llm as llm
from dolfinx_llm import compat
from dolfinx_llm.contact import load_steps
from dolfinx_llm.forms import choice
from dolfinx_llm.operators.bodies import Bodies

COMM = MPI.COMM_SELF
FORMS = ("flexibility", "saddle", "condensed")
WEIGHT = 10.0


@pytest.fixture(params=FORMS)
def solver(request, monkeypatch):
    """The argument ``solver`` for a form, where contact laws are at work."""
    monkeypatch.setattr(choice, "FLEXIBLE", 10**6 if request.param == "flexibility" else 0)
    return "saddle" if request.param == "flexibility" else request.param


@pytest.fixture
def at_once(monkeypatch):
    """A load step that would be halved fails the test."""

    def info(text, *_):
        assert "parts" not in text

    monkeypatch.setattr(load_steps.log, "info", info)


def arch(thickness, solver, count=7):
    """Half a ring of ``count`` stones under its weight, on a rigid floor, its middle line of
    radius 1."""
    blocks, angle = [], np.pi / count
    for k in range(count):

        def bend(x, k=k):
            phi = np.pi - (k + x[:, 1]) * angle
            r = 1.0 - 0.5 * thickness + thickness * x[:, 0]
            return np.column_stack([r * np.cos(phi), r * np.sin(phi)])

        n = 3 + k % 2, 2
        blocks.append(scenes.rectangle(COMM, n, (0, 0), (1, 1), "quadrilateral", move=bend))
    spaces = [compat.function_space(domain, shape=(2,)) for domain, _ in blocks]
    forms = [(ufl.TrialFunction(V), ufl.TestFunction(V)) for V in spaces]
    tags, law = [t for _, t in blocks], llm.Coulomb(1.0)
    sides = [((tags[k], scenes.ABOVE), (tags[k + 1], scenes.BELOW)) for k in range(count - 1)]
    ends = [(tags[0], scenes.BELOW), (tags[-1], scenes.ABOVE)]
    floor = llm.RigidPlane((0, 0), (0, 1))
    return llm.ContactProblem(
        [ufl.inner(scenes.stress(u), ufl.grad(w)) * ufl.dx for u, w in forms],
        [
            ufl.inner(fem.Constant(V.mesh, np.array([0.0, -0.1])), w) * ufl.dx
            for V, (_, w) in zip(spaces, forms, strict=True)
        ],
        interfaces=[llm.Interface(None, side, law=law) for side in sides]
        + [llm.Interface(facets, (tag, floor), law=law) for facets, tag in ends],
        solver=solver,
    )


RUNAWAYS = {
    "dragged with 3 mu N": ([0.3], (0.9, -1.0), r"body 1 .*translation along \[1.0, 0.0\]"),
    "pulled off": ([0.3], (0.0, 1.0), r"body 1 .*translation along \[0.0, 1.0\]"),
    "tipped over": ([5.0], (3.0, -1.0), r"body 1 .*rotation about \[0.85, 1.0\]"),
    "slides on the second": ([0.3, 0.2], (0.25, -1.0), r"body 2 .*translation along \[1.0, 0.0\]"),
}


def by_turns(*rows):
    """Parameters with the forms, each row in every run with one of them."""
    rows = [row if isinstance(row, tuple) else (row,) for row in rows]
    every = [(*row, form) for row in rows for form in FORMS]
    return some_of(every, [(*row, FORMS[k % 3]) for k, row in enumerate(rows)])


@pytest.mark.parametrize(("name", "solver"), by_turns(*RUNAWAYS), indirect=["solver"])
def test_runaway(name, solver, at_once):
    """The body and its motion are told, with the force that nothing takes, from one load step."""
    frictions, load, motion = RUNAWAYS[name]
    loads = [(0.0, 0.0), *[(0.0, -WEIGHT)] * (len(frictions) - 1), WEIGHT * np.array(load)]
    stack = Stack([llm.Coulomb(mu) for mu in frictions], loads=loads, solver=solver)
    with pytest.raises(llm.ContactError, match=f"do not balance the load.*{motion}") as caught:
        stack.solve()
    area = 2.0 * (1.0 - 0.15 * len(frictions))
    if name == "pulled off":  # all of the load
        assert f"force along it {area * WEIGHT:.3g}" in str(caught.value)
    if name == "slides on the second":  # what friction leaves of it
        force = (0.25 - 0.2) * area * WEIGHT
        said = float(str(caught.value).split("force along it ")[1].split(".  ")[0].split(". ")[0])
        assert said <= 1.01 * force


SPACE = {  # forces per volume at x - (0, 0, 1.5), over a pressing one
    "dragged": ([0.6, 0.6, -1.0], 0.0, r"1 .*translation along \[0\.[67]\d*, 0\.[67]\d*, 0\.0\]"),
    "pulled off": ([0.0, 0.0, 1.0], 0.0, r"body 1 .*translation along \[0.0, 0.0, 1.0\]"),
    "turned": ([0.0, 0.0, -1.0], 3.0, r"body 1 .*rotation about \[.*axis \[0.0, 0.0, 1.0\]"),
}


@pytest.mark.parametrize(("name", "solver"), by_turns(*SPACE), indirect=["solver"])
def test_runaway_in_3d(name, solver, at_once):
    """A block on another, dragged, pulled off, or turned about the normal against friction."""
    force, turn, motion = SPACE[name]
    ends = ((-1.0, -1.0, 0.0), (1.0, 1.0, 1.0)), ((-0.7, -0.7, 1.0), (0.7, 0.7, 2.0))
    made = [
        pairs.block(COMM, (n, n, 1), *at, "hexahedron") for n, at in zip((4, 3), ends, strict=True)
    ]
    spaces = [compat.function_space(domain, shape=(3,)) for domain, _ in made]
    below, above = spaces
    u = [ufl.TrialFunction(V) for V in spaces]
    w = [ufl.TestFunction(V) for V in spaces]
    x = ufl.SpatialCoordinate(above.mesh)
    load = ufl.as_vector([force[0] - turn * x[1], force[1] + turn * x[0], force[2]])
    at_rest = fem.Constant(below.mesh, np.zeros(3))
    problem = llm.ContactProblem(
        [ufl.inner(scenes.stress(a), ufl.grad(b)) * ufl.dx for a, b in zip(u, w, strict=True)],
        [ufl.inner(at_rest, w[0]) * ufl.dx, ufl.inner(WEIGHT * load, w[1]) * ufl.dx],
        bcs=scenes.hold_all(below, lambda p: np.isclose(p[2], 0.0), lambda p: 0.0 * p),
        interfaces=llm.Interface(
            None, ((made[0][1], scenes.ABOVE), (made[1][1], scenes.BELOW)), law=llm.Coulomb(0.3)
        ),
        solver=solver,
    )
    with pytest.raises(llm.ContactError, match=f"do not balance the load.*{motion}"):
        problem.solve()


def test_wrong_option_is_named_at_once(solver, at_once):
    """Also where every iteration factorises anew: no smaller load step is tried."""
    loads = [(0.0, 0.0), (0.1 * WEIGHT, -WEIGHT)]
    stack = Stack([llm.Coulomb(0.3)], loads=loads, solver=solver, petsc_options={"ksp_tpye": "cg"})
    with pytest.raises(llm.ContactInputError, match="'ksp_tpye' is no option"):
        stack.solve()


@pytest.mark.parametrize(("load", "solver"), by_turns(0.27, 0.299), indirect=["solver"])
def test_below_the_limit(load, solver):
    stack = Stack([llm.Coulomb(0.3)], loads=[(0, 0), (load * WEIGHT, -WEIGHT)], solver=solver)
    stack.solve()
    area = 1.7
    force = np.array([load, -1.0]) * area * WEIGHT
    assert np.abs(stack.problem.results[0].resultant + force).max() <= 1e-10 * WEIGHT


@pytest.mark.parametrize(("thickness", "solver"), by_turns(0.12, 0.08), indirect=["solver"])
def test_arch(thickness, solver):
    """Couplet: half a ring stands from a thickness of 0.107 radii on; four hinges open below."""
    stands = (
        contextlib.nullcontext()
        if thickness > 0.107
        else pytest.raises(llm.ContactError, match="body 0 .*rotation about.*body 6 .*rotation")
    )
    with stands:
        arch(thickness, solver).solve()


@pytest.mark.parametrize("solver", some_of(FORMS, FORMS[1:2]), indirect=True)
def test_unloaded_body_stays(solver):
    """A body between two that part: where it rests no later step finds it elsewhere."""
    stack = Stack([llm.Coulomb(0.2)] * 2, tops=(2,), solver=solver)
    answers = []
    for down in (0.01, -0.02, 0.01):
        stack.tops[2].interpolate(lambda p, down=down: np.array([0.0 * p[0], 0.0 * p[0] - down]))
        answers.append(np.concatenate([u.x.array for u in stack.solve()]))
    assert np.abs(answers[1]).max() <= 0.03
    assert np.abs(answers[2] - answers[0]).max() <= 1e-9 * np.abs(answers[0]).max()


def dense(M):
    rows, columns, values = M.getValuesCSR()
    return csr_matrix((values, columns, rows), M.getSize()).toarray()


def eliminate(A, b):
    """Gauss's elimination in extended precision."""
    A, b = A.astype(np.longdouble), b.astype(np.longdouble)
    n = len(b)
    for k in range(n):
        p = k + int(np.argmax(np.abs(A[k:, k])))
        A[[k, p]], b[[k, p]] = A[[p, k]], b[[p, k]]
        factor = A[k + 1 :, k] / A[k, k]
        A[k + 1 :, k:] -= np.outer(factor, A[k, k:])
        b[k + 1 :] -= factor * b[k]
    x = np.zeros(n, np.longdouble)
    for k in range(n - 1, -1, -1):
        x[k] = (b[k] - A[k, k + 1 :] @ x[k + 1 :]) / A[k, k]
    return x


def exact(problem):
    """u of (31) with the pairs that are in contact, in extended precision."""
    K, B, L, c = dense(problem.K), dense(problem.B), dense(problem.L_b), problem.scale
    f = problem.bulk.load()
    g = problem.operators.gap(f)
    status = np.concatenate([side.status != 0 for r in problem.results for side in r.sides])
    on = np.zeros(len(g), dtype=bool)
    on[problem.operators.rows.numbering.number] = np.repeat(status, len(g) // len(status))
    n, m, k = len(K), int(on.sum()), L.shape[1]
    A = np.zeros((n + m + k, n + m + k))
    A[:n, :n], A[:n, n : n + m], A[n : n + m, :n] = K / c, B[:, on], B[:, on].T
    A[n : n + m, n + m :], A[n + m :, n : n + m] = -L[on], -L[on].T
    A[n + m :, n + m :] = -1e-17 * np.eye(k)  # frame nodes without contact
    return eliminate(A, np.concatenate([f / c, -g[on], np.zeros(k)]))[:n].astype(float)


SPRINGS = [1.0, 1e-4, 1e-6, 1e-8, 1e-10, 1e-12]
MODULI = [(1.0, 1.0), (1.0, 1e6), (1e6, 1.0)]


@pytest.mark.parametrize(
    ("spring", "moduli", "solver"),
    drawn(SPRINGS, MODULI, FORMS, every=3),
    indirect=["solver"],
)
def test_weak_springs(spring, moduli, solver, caplog):
    """Along the surface springs alone hold a pressed block. The stiffness of the block itself
    stands beside theirs, with its rounding; where that tells, it is said by how much."""
    stack = Stack(
        [llm.Frictionless()], springs=[0.0, spring], moduli=list(moduli),
        loads=[(0.0, 0.0), (0.0, -WEIGHT)], solver=solver,
    )  # fmt: skip
    with caplog.at_level(logging.WARNING, "dolfinx_llm"):
        u = np.concatenate([u.x.array for u in stack.solve()])
    found = exact(stack.problem)
    error = np.abs(u - found).max() / np.abs(found).max()
    drift = stack.problem.method.iteration.verdict.drift
    assert error <= max(1e-15 / spring, 1e-10 if moduli[1] > 1.0 else 1e-11)
    assert error <= max(drift, 1e-9 if moduli[1] > 1.0 else 1e-10)
    assert drift <= 1e-13 / spring
    assert ("displacements may be off" in caplog.text) == (drift > 1e-8)


@pytest.mark.parametrize(("spring", "solver"), by_turns(1e-3, 1e-6, 1e-8), indirect=["solver"])
def test_springs_that_carry(spring, solver):
    """A block drawn along the surface by a force that its springs alone carry."""
    stack = Stack(
        [llm.Frictionless()], springs=[0.0, spring],
        loads=[(0.0, 0.0), (0.3 * WEIGHT, -WEIGHT)], solver=solver,
    )  # fmt: skip
    u = np.concatenate([u.x.array for u in stack.solve()])
    found = exact(stack.problem)
    assert np.abs(u - found).max() <= 1e-14 / spring * np.abs(found).max()
    shift = 0.3 * WEIGHT / (spring * scenes.E)
    assert abs(np.abs(u).max() / shift - 1.0) <= 1e-2


@pytest.mark.parametrize("law", [llm.Frictionless(), llm.Tied()], ids=str)
def test_rounding_is_named(law, solver):
    """Springs that carry the load, too weak for double precision: not a body that is pulled off."""
    stack = Stack(
        [law], springs=[1e-12, 1e-12], held=() if isinstance(law, llm.Tied) else (0,),
        loads=[(0.0, 0.0), (0.3 * WEIGHT, -WEIGHT)], solver=solver,
    )  # fmt: skip
    with pytest.raises(llm.ContactError, match="rounding alone may change the forces"):
        stack.solve()


@pytest.mark.parametrize(
    ("ratio", "spring", "solver"),
    by_turns((1e4, 1e-4), (1e4, 1e-6), (1e6, 1e-6)),
    indirect=["solver"],
)
def test_stiff_on_soft(ratio, spring, solver):
    """Coulomb, weak supports below: rounding is told, and refused where it leaves too little."""
    stack = Stack(
        [llm.Coulomb(0.5)], moduli=[1.0, ratio], springs=[spring, 0.0], held=(),
        loads=[(0.0, 0.0), (0.1 * WEIGHT, -WEIGHT)], solver=solver,
    )  # fmt: skip
    if ratio > 1e5:
        with pytest.raises(llm.ContactError, match="rounding alone may change the forces"):
            stack.solve()
        return
    stack.solve()
    force = np.array([0.1, -1.0]) * 1.7 * WEIGHT
    rounding = stack.problem.method.iteration.verdict.rounding
    error = np.abs(stack.problem.results[0].resultant + force).max() / (1.7 * WEIGHT)
    assert error <= 10.0 * rounding
    assert rounding <= 2e-15 * ratio / spring


@pytest.mark.parametrize("solver", ["flexibility", "condensed"], indirect=True)
def test_light_contact_beside_an_open_one(solver, monkeypatch):
    """A block pressed on its floor by a force that is nothing beside its stiffness times the
    distance of a wall that it does not touch: its answer is looked at nevertheless. (Not in the
    saddle form: rounding of the distance is in all of its solution.)"""
    domain, tags = scenes.rectangle(COMM, (3, 2), (0.0, 0.0), (1.0, 1.0), "quadrilateral")
    V = compat.function_space(domain, shape=(2,))
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    weight = fem.Constant(domain, np.array([0.0, -1e-9]))
    problem = llm.ContactProblem(
        ufl.inner(scenes.stress(u), ufl.grad(w)) * ufl.dx, ufl.inner(weight, w) * ufl.dx,
        bcs=hold(V, ((0, lambda p: np.isclose(p[0], 0.0)),)),
        interfaces=[
            llm.Interface(tags, (tag, llm.RigidPlane(point, normal)), law=llm.Frictionless())
            for tag, point, normal in (
                (scenes.BELOW, (0.0, 0.0), (0.0, 1.0)), (scenes.ABOVE, (0.0, 1e6), (0.0, -1.0))
            )
        ],
        solver=solver,
    )  # fmt: skip
    problem.solve()
    assert problem.results[0].resultant[1] == pytest.approx(-1e-9, rel=1e-6)
    form = type(problem.method.iteration.form)
    right = form.displacement
    monkeypatch.setattr(form, "displacement", lambda self, found: 1.01 * right(self, found))
    with pytest.raises(llm.ContactError, match="of the forces' size is left"):
        problem.solve()


def test_motions_in_words():
    """A rotation about a point, a screw, a translation; from amounts of a body's own motions."""
    domain, _ = scenes.rectangle(COMM, (2, 2), (1.0, 0.0), (3.0, 2.0), "quadrilateral")
    bodies = Bodies([compat.function_space(domain, shape=(2,))])
    half = np.sqrt(2.0)  # of the diagonal: the unit of rotations
    turn = bodies.motion(0, np.array([1.0, 0.0, half]), 3.0)  # by 1, and u = (1, 0) at the middle
    assert "rotation about [2.0, 2.0]" in turn and "moment about it 3" in turn
    assert "translation along [0.6, 0.8], force along it 2" in bodies.motion(
        0, np.array([3.0, 4.0, 0.0]), 10.0
    )
