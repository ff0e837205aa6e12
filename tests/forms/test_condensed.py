"""The condensed form against the saddle form, against dense oracles, and its own manners."""

from dataclasses import replace

import both_forms
import condensed_reuse
import friction_bound
import numpy as np
import patch3d
import pytest
import scenes
import solve_scenes
import ufl
from conftest import run_mpi_json
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc
from sampling import longer, some_of

import dolfinx_llm as llm
from dolfinx_llm.contact.equations import equations, proximal
from dolfinx_llm.contact.results import results
from dolfinx_llm.forms import cost
from dolfinx_llm.forms.condensed import friction, friction_system, krylov, modes
from dolfinx_llm.forms.condensed import kept as multigrid
from dolfinx_llm.forms.condensed import system as condensed
from dolfinx_llm.forms.condensed.splitting import SplitStiffness
from dolfinx_llm.operators.petsc import products

COMM = MPI.COMM_SELF
DIRECT = {"ksp_type": "preonly", "pc_type": "cholesky"}

# Against the saddle form


@pytest.mark.parametrize(
    ("n", "names"),
    [(1, slice(0, None, 4)), longer(1, slice(2, None, 4)), longer(2, slice(1, None, 4)),
     (3, slice(3, None, 32)), longer(3, slice(7, None, 16)), longer(3, slice(11, None, 8)),
     longer(3, slice(19, None, 32))],
)  # fmt: skip
def test_forms_agree(n, names):
    """u, λ, v by Cholesky and by CG + GAMG at the default tolerance; half of the scenes on one
    rank, a quarter each on two and on three."""
    names = list(both_forms.SCENES)[names]
    found = run_mpi_json("both_forms.py", n, *names)
    assert len(found) == 2 * len(names)
    wrong = {
        name: errors for name, errors in found.items() if not max(errors.values()) <= bound(name)
    }
    assert wrong == {}


def bound(name):
    return 1e-10 if name.endswith("CG") else 1e-12


@pytest.mark.parametrize("seed", some_of(range(120, 135), range(120, 135, 6)))
def test_random_pairs(seed):
    problem = both_forms.random_pair(seed)(COMM)
    for options in (DIRECT, None):
        errors = both_forms.differences(problem, options)
        assert max(errors.values()) <= 1e-10, (options, errors)


# Against a dense solution, with other components eliminated than a tied interface's


@pytest.mark.parametrize("n", [1, 3])
def test_parts_of_the_components(n):
    """Normals only; random components of turned bases at symmetry planes, open nodes, and frame
    unknowns that a proximal term alone holds."""
    found = run_mpi_json("condensed_oracle.py", n)
    assert len(found) == 8
    for name, errors in found.items():
        assert errors.pop("idle") > 0, name
        assert max(errors.values()) <= 1e-10, (name, errors)


# Patch test


def von_mises_error(options):
    problem = solve_scenes.paper_scene(COMM, "predicted")
    problem.method.renew(replace(problem.method.setting, form="condensed", options=options))
    return patch3d.stress_error(problem.solve())


def test_patch_test():
    assert von_mises_error(DIRECT) <= 1e-12
    assert von_mises_error({"ksp_rtol": 1e-14}) <= 1e-10


# Set-up and options


def blocks(solver="condensed", options=None, a=None, **chosen):
    """Clamped blocks under a load that ``load`` scales."""
    V, tags = scenes.two_blocks(COMM)
    stiffness, L = solve_scenes.loaded_forms(V)
    load = fem.Constant(V.mesh, 1.0)
    contact = llm.ContactProblem(
        stiffness if a is None else a(V),
        load * L,
        bcs=scenes.hold(V, solve_scenes.CLAMPED),
        interfaces=[llm.Interface(tags, (2, 3))],
        solver=solver,
        petsc_options=options,
        **chosen,
    )
    return contact, load


@pytest.mark.parametrize("options", [None, DIRECT])
def test_second_solve_keeps_the_set_up(options, monkeypatch):
    contact, load = blocks(options=options)
    first = contact.solve().x.array.copy()
    calls = []
    for module, name in ((krylov, "solver_of"), (condensed, "Transformation")):
        monkeypatch.setattr(module, name, lambda *args, name=name: calls.append(name))
    load.value = -3.0
    second = contact.solve().x.array
    assert calls == []
    assert np.abs(second + 3.0 * first).max() <= 1e-11 * np.abs(second).max()


@pytest.mark.parametrize("options", [None, DIRECT])
def test_ties_ask_for_what_they_need(options, monkeypatch):
    """Neither for rows of frames, which are laws', nor which nodes are about the rim of contact,
    where both sides cover each other."""

    def asked(*args):
        raise AssertionError("is not needed")

    for module, name in (
        (proximal, "proximal_term"), (equations, "HeldRows"), (results, "adjacency"),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, asked)
    contact, _ = blocks(options=options)
    contact.solve()
    assert contact.results[0].certificate.residual < 1e-13


def test_sizes():
    """K's storage is used, idle at the tied nodes; only the frame adds to it."""
    contact, _ = blocks()
    entries = contact.K.getInfo()["nz_used"]
    surface = contact.unknowns["lambda"]
    contact.solve()
    system, n_v = contact.method.form.system, contact.unknowns["v"]
    assert system.matrix.getSize() == (contact.unknowns["u"] + n_v,) * 2
    assert system.matrix.getBlockSize() == 3
    assert not system.form.tail.idle.any() and (system.form.tail.left == -1).all()
    assert len(system.split.surface) == surface
    indptr, columns, _ = system.matrix.getValuesCSR()
    rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
    n_u = contact.unknowns["u"]
    assert ((rows < n_u) & (columns < n_u)).sum() == entries


def test_options_leave_no_trace():
    before = PETSc.Options().getAll()
    contact, _ = blocks(options={"ksp_rtol": 1e-8, "pc_gamg_threshold": 0.02})
    contact.solve()
    system = contact.method.form.system
    assert system.solver.ksp.getTolerances()[0] == 1e-8
    assert system.solver.ksp.getPC().getType() == "gamg"
    assert PETSc.Options().getAll() == before
    contact, _ = blocks(options=DIRECT)
    contact.solve()
    assert contact.method.form.system.solver.ksp.getPC().getFactorSolverType() == "mumps"
    assert PETSc.Options().getAll() == before


def test_options_of_the_command_line():
    """By prefix, before all others."""
    PETSc.Options()["mine_pc_type"] = "cholesky"
    try:
        contact, _ = blocks(petsc_options_prefix="mine_")
        contact.solve()
        assert contact.method.form.system.solver.ksp.getPC().getFactorSolverType() == "mumps"
        assert contact.method.form.system.iterations <= 3
    finally:
        PETSc.Options().delValue("mine_pc_type")


def test_too_few_iterations_are_refused():
    contact, _ = blocks(options={"ksp_max_it": 2})
    with pytest.raises(llm.ContactError, match="solve failed: .* 2 iterations of CG"):
        contact.solve()


def test_factorisation_takes_over(monkeypatch):
    """Where the default options do not converge, and says so."""
    known = blocks("saddle")[0].solve().x.array
    monkeypatch.setattr(krylov, "PATIENCE", 3)
    contact, load = blocks()
    for value in (1.0, 2.0):
        load.value = value
        found = contact.solve().x.array
        assert np.abs(found - value * known).max() <= 1e-12 * np.abs(found).max()
    assert "Cholesky by MUMPS instead" in str(contact)
    assert len(contact.method.form.system.notes) == 1


def unsymmetric(V):
    u, w = ufl.TrialFunction(V), ufl.TestFunction(V)
    return ufl.inner(scenes.stress(u), ufl.grad(w)) * ufl.dx + 500.0 * u[0] * w[1] * ufl.dx


def test_unsymmetric_stiffness():
    with pytest.raises(llm.ContactError, match="needs a symmetric stiffness"):
        blocks(a=unsymmetric)
    contact, _ = blocks("auto", a=unsymmetric)
    contact.solve()
    assert "saddle" in str(contact) and "not symmetric" in str(contact)


def test_auto(monkeypatch):
    """By size; either way the same answer, and ``print`` says what was chosen and why."""
    contact, _ = blocks("auto")
    small = contact.solve().x.array.copy()
    assert contact.form == "saddle" and "chosen: least work" in str(contact)
    monkeypatch.setattr(cost, "SWEPT", 0.0)
    contact, _ = blocks("auto")
    large = contact.solve().x.array
    assert "condensed, CG + GAMG" in str(contact) and "condensed 0 s" in str(contact)
    assert np.abs(large - small).max() <= 1e-12 * np.abs(small).max()


# Steps of contact laws


@pytest.mark.parametrize("n", [1, longer(2), longer(3)])
def test_steps_reuse_the_set_up(n):
    """Load steps without friction: the flexibility's answer, with one preconditioner as long as
    the pairs in contact stay, and with other loads."""
    found = run_mpi_json("condensed_reuse.py", n)
    for name, outcome in found.items():
        assert outcome["error"] <= 1e-10 and outcome["residual"] <= 1e-13, name
    closed, bent = (found["pressed"], found["twice"]), found["bent"]
    for outcome in closed:
        assert outcome["set-ups"] == 1 and len(set(outcome["active"])) == 1
    first, later = (sum(outcome["iterations"]) for outcome in closed)
    assert later <= 1.1 * first  # none for what is built anew
    assert (
        1 < bent["set-ups"] <= len(bent["active"]) and bent["active"][-1] < closed[0]["active"][0]
    )


def test_steps_reuse_a_factorisation(monkeypatch):
    """A factorisation serves all steps with the same pairs and the same proximal term."""
    V, tags = scenes.two_blocks(COMM, 4, 3)
    problem, constants = condensed_reuse.blocks(V, tags, "condensed", DIRECT)
    reduced = []
    eliminate = condensed.CondensedSystem.eliminate
    count = lambda self, *args: (reduced.append(1), eliminate(self, *args))  # noqa: E731
    monkeypatch.setattr(condensed.CondensedSystem, "eliminate", count)
    steps = [active for _, _, active in condensed_reuse.follow(problem, constants)]
    system = problem.method.form.system
    assert system.solver.set_ups == 1 + len(reduced)
    # Pairs whose sign is wrong are asked for besides.
    assert len(system.steps) >= sum(map(len, steps)) >= system.solver.set_ups
    problem.destroy()


@pytest.mark.mpi
def test_friction_where_a_rank_owns_clamped_nodes_alone():
    """It hung where only one rank's last displacement was not zero."""
    T, N = np.abs(run_mpi_json("clamped_rank.py", 2)["resultants"]).T
    assert (T[:-1] < 0.5 * N[:-1]).all() and abs(T[-1] - 0.5 * N[-1]) <= 1e-12 * N[-1]


HALF, OTHERS = (tuple(list(friction_bound.SCENES)[k::2]) for k in (0, 1))


@pytest.mark.parametrize(
    ("n", "names"),
    [(1, HALF), longer(1, OTHERS), longer(2, ("line",)), longer(2, ("lower clamped, plane",))],
)
def test_friction_where_supports_bind_the_frame(n, names):
    """Symmetry planes and clamped nodes through the contact, in all three forms."""
    states = []
    for name, forms in run_mpi_json("friction_bound.py", n, *names).items():
        states.append(forms.pop("states"))
        worst = {form: max(errors) for form, errors in forms.items()}
        assert len(worst) == 3 and max(worst.values()) <= 1e-10, (name, worst)
    assert sum(stick > 0 for _, stick, _ in states) == len(states)
    assert sum(slip > 0 for _, _, slip in states) >= min(2, len(states))


def test_worn_preconditioner_is_renewed(monkeypatch):
    """In the middle of a solve, where it takes too many iterations."""
    V, tags = scenes.two_blocks(COMM, 4, 3)
    known = condensed_reuse.follow(*condensed_reuse.blocks(V, tags, "auto"))
    problem, constants = condensed_reuse.blocks(V, tags, "condensed", {"ksp_type": "cg"})
    monkeypatch.setattr(krylov, "COST", 0.0)
    for (_, u, _), (_, v, _) in zip(known, condensed_reuse.follow(problem, constants)):
        assert np.abs(u - v).max() <= 1e-10 * np.abs(u).max()
        monkeypatch.setattr(krylov, "WORN", 0.3)
    # COST being zero, nothing else renews one.
    assert problem.method.form.system.solver.set_ups > 1


def test_what_matrices_share_is_stored_once(monkeypatch):
    """A preconditioner that is kept needs the matrix that it was made of: the next one is known by
    its products, which are those of the same when it is stored."""
    V, tags = scenes.two_blocks(COMM, 4, 3)
    problem, constants = condensed_reuse.blocks(V, tags, "condensed", {"ksp_type": "cg"})
    monkeypatch.setattr(krylov, "COST", 0.0)  # keep it
    for _ in condensed_reuse.follow(problem, constants):
        system = problem.method.form.system
        if system.reduced.matrix.getType() == "python":
            break
    reduced, rng = system.reduced, np.random.default_rng(2001)
    assert reduced.matrix.getType() == "python"
    frames = len(reduced.form.fixed) + reduced.form.tail.seats
    x = rng.standard_normal((len(reduced.S.array_r), 2))

    def of():
        block = reduced.block(frames)
        return [reduced.S.array_r.copy(), products(block, x[: len(frames)]),
                *(reduced.times(column) for column in x.T)]  # fmt: skip

    known = of()
    system.solver.discard()
    reduced.store()
    assert reduced.matrix.getType() == "seqaij"
    for one, other in zip(known, of(), strict=True):
        assert np.abs(one - other).max() <= 1e-13 * np.abs(other).max()
    problem.destroy()


# Friction


def dragged(solver):
    """Forces in load steps from stick to gross slip, and the problem."""
    V, tags = scenes.two_blocks(COMM, 4, 3)
    a, L = solve_scenes.loaded_forms(V)
    top = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], V.mesh.geometry.x[:, 2].max()))
    low = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[2], V.mesh.geometry.x[:, 2].min()))
    moved = fem.Function(V)
    bcs = [fem.dirichletbc(moved, top), fem.dirichletbc(np.zeros(3), low, V)]
    problem = llm.ContactProblem(
        a, fem.Constant(V.mesh, 0.0) * L, bcs=bcs,
        interfaces=[llm.Interface(tags, (2, 3), law=llm.Coulomb(0.3))], solver=solver,
        petsc_options={"pc_type": "gamg"} if solver == "condensed" else None,
    )  # fmt: skip
    forces, slip = [], []
    for along in (0.0, 0.002, 0.03):
        moved.x.array.reshape(-1, 3)[top] = [along, 0.3 * along, -0.01 + 0.1 * along]
        problem.solve()
        forces.append(np.concatenate([side.force for side in problem.results[0].sides]))
        slip.append(problem.history[-1]["slip"])
    assert slip[0] < slip[-1]
    return np.array(forces), problem


def test_friction_by_multigrid(monkeypatch):
    """From stick to gross slip; where GMRES gets nowhere, a factorisation takes over."""
    known, _ = dragged("saddle")
    for patience in (friction.HOPELESS, 0):
        monkeypatch.setattr(friction, "HOPELESS", patience)
        found, problem = dragged("condensed")
        assert np.abs(found - known).max() <= 1e-9 * np.abs(known).max()
        assert problem.history[-1]["stick"] == 0 and len(problem.history) <= 6  # 8 unforeseen
        kept = problem.method.form.friction
        assert kept.direct == (patience == 0) == ("LU by MUMPS" in str(problem))


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_opening_by_multigrid(mu):
    """A tilted block, dragged with friction: few steps, none factorised; forces as by flexibility.
    All wrong signs at once open and close the rim by turns."""
    forces = []
    for solver in ("saddle", "condensed"):
        V, tags = scenes.two_blocks(COMM, 6, 5)
        a, L = solve_scenes.loaded_forms(V)
        x = V.mesh.geometry.x
        ends = [
            fem.locate_dofs_geometrical(V, lambda x, z=z: np.isclose(x[2], z))
            for z in (x[:, 2].max(), x[:, 2].min())
        ]
        moved = fem.Function(V)
        across = V.tabulate_dof_coordinates()[ends[0], 0]
        moved.x.array.reshape(-1, 3)[ends[0], 0] = 0.01 * mu
        moved.x.array.reshape(-1, 3)[ends[0], 2] = -0.006 + 0.06 * (across - across.mean())
        bcs = [fem.dirichletbc(moved, ends[0]), fem.dirichletbc(np.zeros(3), ends[1], V)]
        problem = llm.ContactProblem(
            a, fem.Constant(V.mesh, 0.0) * L, bcs=bcs,
            interfaces=[llm.Interface(tags, (2, 3), law=llm.Coulomb(mu))], solver=solver,
            petsc_options={"pc_type": "gamg"} if solver == "condensed" else None,
        )  # fmt: skip
        problem.solve()
        forces.append(np.concatenate([side.force for side in problem.results[0].sides]))
    kept = problem.method.form.friction
    assert len(problem.history) <= (12 if mu else 6) and not kept.notes and not kept.direct
    assert problem.history[0]["active"] > problem.history[-1]["active"] > 0
    assert np.abs(forces[1] - forces[0]).max() <= 1e-9 * np.abs(forces[0]).max()


@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_bodies_that_contact_holds_by_multigrid(mu):
    """Pressed, then bent until a part opens; nothing but contact holds the upper block against the
    load."""
    V, tags = scenes.two_blocks(COMM, 6, 5)
    law, gamg = llm.Coulomb(mu), {"pc_type": "gamg"}
    known = condensed_reuse.follow(*condensed_reuse.blocks(V, tags, "auto", law=law))
    problem, constants = condensed_reuse.blocks(V, tags, "condensed", gamg, law)
    for (_, u, _), (_, v, _) in zip(known, condensed_reuse.follow(problem, constants)):
        assert np.abs(u - v).max() <= 1e-10 * np.abs(u).max()
    kept = problem.method.form.friction or problem.method.form.system
    assert not kept.notes and not kept.direct


def test_friction_takes_as_many_iterations_with_another_multigrid(monkeypatch):
    """Of nodes that all stick, corrected where they slip, as with one of each state."""
    took = []
    for worn, slips in ((np.inf, np.inf), (np.inf, multigrid.MOST), (-1.0, np.inf)):
        monkeypatch.setattr(friction_system, "SET_UP", worn)
        monkeypatch.setattr(multigrid, "MOST", slips)
        kept = dragged("condensed")[1].method.form.friction
        took.append((kept.iterations, kept.set_ups))
    # The second is made anew where all begin to slip.
    assert took[0][1] == 1 < took[1][1] == 2 < took[2][1]
    assert took[0][0] <= 2.0 * took[2][0]


def test_aggregates_are_parted_where_what_stuck_slips(monkeypatch):
    """The multigrid of stick serves slip, parted, as well as one with aggregates of its own that
    know of sliding; forces are the same. Of the old one nothing but its interpolations is left
    before K's inside is taken back."""
    found, holders, leave = [], [], SplitStiffness.leave

    def counted(split, matrix):
        holders.append(matrix.refcount)
        leave(split, matrix)

    monkeypatch.setattr(SplitStiffness, "leave", counted)
    for part in (multigrid.KeptMultigrid.parts, lambda *_: False):
        monkeypatch.setattr(multigrid.KeptMultigrid, "parts", part)
        forces, problem = dragged("condensed")
        kept = problem.method.form.friction
        assert kept.set_ups == 2 and not kept.notes
        found.append((kept.kept.ksp.getPC().getType(), kept.iterations, forces))
    (parted, few, a), (own, many, b) = found
    assert (parted, own) == ("mg", "gamg")
    assert few <= 1.2 * many
    assert np.abs(a - b).max() <= 1e-9 * np.abs(b).max()
    assert holders and max(holders) == 1


def test_multigrid_of_slip_knows_that_bodies_slide(monkeypatch):
    """Without these motions multigrids of steps that slip, made anew for each, take more
    iterations; forces are the same."""
    found = []
    monkeypatch.setattr(friction_system, "SET_UP", -1.0)
    for know in (True, False):
        if not know:
            monkeypatch.setattr(
                modes,
                "sliding_modes_of",
                lambda operators: tuple(a[:, :0] for a in modes.rigid_modes_of(operators)),
            )
        forces, problem = dragged("condensed")
        kept = problem.method.form.friction
        assert kept.set_ups > 2 and not kept.notes
        found.append((kept.iterations, forces))
    (few, a), (many, b) = found
    assert few <= 0.9 * many
    assert np.abs(a - b).max() <= 1e-9 * np.abs(b).max()
