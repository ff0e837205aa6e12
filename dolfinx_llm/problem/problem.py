"""The user's door: a linear elastic problem whose bodies touch."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse
import ufl
from dolfinx import fem
from petsc4py import PETSc

from dolfinx_llm.base import compat
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.log import progress
from dolfinx_llm.base.parallel import check, gather_rows
from dolfinx_llm.base.timing import Timer
from dolfinx_llm.contact.doubts import doubts
from dolfinx_llm.contact.iteration import ContactIteration
from dolfinx_llm.contact.results import InterfaceResult, collect_results
from dolfinx_llm.forms.choice import SOLVERS, build_steps, build_system, choose_solver, warn
from dolfinx_llm.forms.choice import describe as describe_solver
from dolfinx_llm.geometry.surface import check_space
from dolfinx_llm.interface.anatomy import describe
from dolfinx_llm.interface.build import build_model
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.operators.assemble import (
    assemble_B,
    assemble_gap,
    assemble_L_b,
    interface_operator,
)
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.numbering import Numbering, Rows, frame_numbering
from dolfinx_llm.operators.petsc import mean_diagonal
from dolfinx_llm.operators.prescribed import prescribed_rows
from dolfinx_llm.operators.support import check_loops, check_support

log = logging.getLogger("dolfinx_llm")


class ContactProblem:
    """Bodies with stiffness a and load L that touch along interfaces, (31) of the paper.

    Args:
        a: bilinear UFL form of the bodies; a sequence of them for bodies on several meshes.
        L: linear UFL form, or a sequence of them.
        bcs: Dirichlet conditions.
        interfaces: the ``Interface`` objects.
        nodal_loads: Functions of nodal forces, added to the assembled L.
        solver: "saddle": (31) with MUMPS; "condensed": the surfaces' displacements written in the
            frame's, by conjugate gradients with GAMG, or by Cholesky with petsc_options
            {"ksp_type": "preonly", "pc_type": "cholesky"}; "auto": by size.
        petsc_options_prefix: of the options of the linear solver.
        petsc_options: PETSc options on top of the solver's own.

    Attributes:
        results: after ``solve``, an ``InterfaceResult`` per interface, the same on every rank.
        history: of the last ``solve``, a dict per iteration: "iteration", "active" (pairs in
            contact), "stick", "slip", "residual" (relative), with laws that iterate "changes".
        times: seconds per stage, summed over all calls.
        models: a ``ContactModel`` per interface: surfaces, frame, pairs and certificate.
        spaces: function space of each mesh.
        K, B, L_b: PETSc matrices of (31).
        scale: mean stiffness of the surfaces, the unit of λ in the solvers [force / length].

    Raises:
        ContactInputError: arguments that do not fit.
        ContactError: a scene that cannot be solved.
    """

    def __init__(
        self,
        a: ufl.Form | Sequence[ufl.Form],
        L: ufl.Form | Sequence[ufl.Form],
        *,
        bcs: Sequence[Any] = (),
        interfaces: Interface | Sequence[Interface] = (),
        nodal_loads: Sequence[fem.Function] = (),
        solver: str = "auto",
        petsc_options_prefix: str = "llm_",
        petsc_options: dict | None = None,
    ):
        self._several = isinstance(a, (list, tuple))
        forms_a, forms_L = (list(a), list(L)) if self._several else ([a], [L])
        if solver not in SOLVERS:
            raise ContactInputError(f"solver={solver!r}: choose one of {SOLVERS}")
        if len(forms_a) != len(forms_L):
            raise ContactInputError(f"{len(forms_a)} bilinear forms, {len(forms_L)} linear ones")
        interfaces = [interfaces] if isinstance(interfaces, Interface) else list(interfaces)
        if not interfaces:
            raise ContactInputError("give at least one Interface")
        self.interfaces, self.solver = interfaces, solver
        self.times: dict[str, float] = {}
        self.history: list[dict] = []
        self.results: list[InterfaceResult] = []
        self._K: Any = None  # see K
        self._system: Any = None  # of (31), factorised
        self._iteration: Any = None  # ContactIteration, once there is one
        self._prefix, self._options = petsc_options_prefix, petsc_options
        with self._timed("form compilation"):
            self._a = [fem.form(form) for form in forms_a]
            self._L = [fem.form(form) for form in forms_L]
        self.spaces = [_argument_space(form) for form in forms_a]
        self.comm = self.spaces[0].mesh.comm
        for V in self.spaces:
            check_space(V)
        self._bcs = [[bc for bc in bcs if compat.in_space(bc, V)] for V in self.spaces]
        if sum(map(len, self._bcs)) != len(bcs):
            raise ContactInputError("a Dirichlet condition belongs to none of the forms' spaces")
        self._nodal = [
            [load for load in nodal_loads if load.function_space.mesh is V.mesh]
            for V in self.spaces
        ]
        if sum(map(len, self._nodal)) != len(nodal_loads):
            raise ContactInputError("a nodal load lives on none of the forms' meshes")
        for V, loads in zip(self.spaces, self._nodal):
            wrong = [load.name for load in loads if _layout(load.function_space) != _layout(V)]
            text = f"nodal load(s) {wrong}: must be Functions of the space of the form"
            check(self.comm, bool(wrong), text, ContactInputError)
        fixed = [compat.prescribed_values(V, bcs) for V, bcs in zip(self.spaces, self._bcs)]
        self._sizes = [V.dofmap.index_map.size_local * V.mesh.geometry.dim for V in self.spaces]
        fixed = [~np.isnan(values[:n]) for values, n in zip(fixed, self._sizes)]
        self._fixed = np.concatenate(fixed)
        self.models = [build_model(interface, self.spaces, fixed) for interface in interfaces]
        for model in self.models:
            for stage, seconds in model.times.items():
                self._add_time(stage, seconds)
        self._assemble_operators()

    @property
    def u(self) -> fem.Function | list[fem.Function]:
        """The displacement of the last ``solve``, as it was returned.

        Raises:
            ContactError: nothing has been solved.
        """
        if not self.results:
            raise ContactError("there is no displacement yet: call solve() first")
        return self._u if self._several else self._u[0]

    def _timed(self, stage: str) -> Timer:
        return Timer(stage, self._add_time)

    def _add_time(self, stage: str, seconds: float) -> None:
        self.times[stage] = self.times.get(stage, 0.0) + seconds

    @property
    def K(self) -> PETSc.Mat:
        """PETSc AIJ of the bodies' stiffness, identity rows and columns at prescribed dofs.

        The condensed form uses it up when it is set up; it is assembled anew when asked for.
        """
        if self._K is None:
            with self._timed("assembly of K"):
                blocks = [compat.assemble_matrix(a, b, 1.0) for a, b in zip(self._a, self._bcs)]
                self._K = blocks[0] if len(blocks) == 1 else _block_diagonal(blocks)
        return self._K

    def _take_K(self) -> PETSc.Mat:
        """K, which the problem no longer has then."""
        K, self._K = self.K, None
        return K

    def _assemble_operators(self) -> None:
        """K, B and L_b."""
        self._first = self.K.getOwnershipRange()[0]  # of this rank's dofs
        if not np.isfinite(self.K.norm()):
            raise ContactError(
                "the stiffness has entries that are NaN or infinite. Check the coefficients of the "
                "forms a and the mesh for degenerate cells"
            )
        with self._timed("operators"):
            self._pairs = [pairs for model in self.models for pairs in model.pairs]
            spaces = [space for model in self.models for space in model.spaces]
            self._dofs = [self._global_dofs(*side) for side in zip(spaces, self._pairs)]
            self._rows = Rows.of(self.comm, self._pairs, self._dofs)
            self._frame_unknowns = frame_numbering(self.models, self.comm)
            bodies = (self.K.getSizes()[0], self._first)
            self.B = assemble_B(self.comm, self._rows, bodies, self._fixed)
            self._L_csr = [
                interface_operator(model.pairs, model.directions) for model in self.models
            ]
            self._find_prescribed(bodies[1])
            kept = scipy.sparse.diags((~self._redundant).astype(float))
            self._L_all = (kept @ scipy.sparse.block_diag(self._L_csr, format="csr")).tocsr()
            self._L_all.eliminate_zeros()
            numbers = self._rows.numbering, self._frame_unknowns
            self.L_b = assemble_L_b(self.comm, self._L_all, *numbers)
            n_l, n_v = self.L_b.getSize()
            self._unknowns = {"u": bodies[0][1], "lambda": n_l, "v": n_v}
        self.scale = self._stiffness_scale(bodies[1])
        with self._timed("support check"):
            self._check_support()
        self.form, self._why = choose_solver(self)

    def _find_prescribed(self, start: int) -> None:
        """Rows of L_b at prescribed dofs, and the redundant ones of ties, which (31) leaves out."""
        mine = self._rows.numbering.mine
        fixed = self._fixed[self._rows.dofs[mine] - start]
        free = np.where(fixed, 0.0, self._rows.base[mine])
        free = np.linalg.norm(self._gather(self._rows.numbering, free), axis=1)
        self._soft, prescribed = free < 1e-3, free == 0.0
        self._redundant = np.zeros(len(prescribed), dtype=bool)
        self._prescribed, first = [], 0
        for model, L in zip(self.models, self._L_csr, strict=True):
            place = slice(first, first + L.shape[0])
            if not model.interface.law.unilateral:
                rows, basis, redundant = prescribed_rows(L, prescribed[place])
                self._prescribed.append((first + rows, basis))
                self._redundant[first + redundant] = True
            first = place.stop

    def _global_dofs(self, space: int, nodes: Any) -> np.ndarray:
        """(n, gdim) numbers, in the vector of all bodies, of the dofs of pairs or a surface."""
        gdim = self.spaces[space].mesh.geometry.dim
        start = self.spaces[space].dofmap.index_map.local_range[0] * gdim
        shift = self._first + sum(self._sizes[:space]) - start
        shift = np.array(self.comm.allgather(shift))[nodes.owner]
        return nodes.dofs[:, None] * gdim + np.arange(gdim) + shift[:, None]

    def _stiffness_scale(self, start: int) -> float:
        """Mean diagonal of K on the free surface dofs [force / length]; the geometric mean where
        bodies may part, since there the softer one tells the forces."""
        rows = self._rows.dofs.ravel() - start
        rows = rows[(rows >= 0) & (rows < len(self._fixed))]
        unilateral = any(model.interface.law.unilateral for model in self.models)
        return mean_diagonal(self.K, rows[~self._fixed[rows]], geometric=unilateral)

    def _check_support(self) -> None:
        self.bodies = Bodies(self.spaces)
        start, gdim = self._first, self.spaces[0].mesh.geometry.dim
        labels = []
        for side, dofs in zip(self._pairs, self._dofs, strict=True):
            mine = side.owner == self.comm.rank
            label = np.zeros(len(mine), dtype=np.int64)
            label[mine] = self.bodies.label[(dofs[mine, 0] - start) // gdim]
            labels.append(self.comm.allreduce(label))
        check_loops(self.models, labels)
        moves = [
            np.einsum("nci,nibm->ncbm", side.base, self.bodies.modes(label, side.x))
            for side, label in zip(self._pairs, labels, strict=True)
        ]
        moves = [m.reshape(-1, *m.shape[2:]) for m in moves]
        constraints = []
        for model, L in zip(self.models, self._L_csr, strict=True):
            of_model, moves = moves[: len(model.pairs)], moves[len(model.pairs) :]
            constraints.append((L if L.shape[1] else None, np.concatenate(of_model)))
        check_support(self.bodies, self.K, self._fixed, constraints)

    def solve(self, increments: int = 1) -> fem.Function | list[fem.Function]:
        """Assemble the load, solve, and fill ``results``.

        With a law that lets bodies part or slip, each call is a load step that starts from the
        state of the one before; ``reset()`` forgets it.

        Args:
            increments: equal parts in which the change of the load since the last call is applied;
                more are taken by themselves where the law does not converge. Tied: not used.

        Returns:
            The displacement: a dolfinx Function, or a list of them for several meshes.

        Raises:
            ContactInputError: increments below 1.
            ContactError: NaN in the load, a system that cannot be solved, a law that does not
                converge.
        """
        if not increments >= 1:
            raise ContactInputError(f"increments={increments!r}: give a number of at least 1")
        with self._timed("assembly of f"):
            f = self._assemble_load()
        g = self._assemble_gap(f)
        if any(model.interface.law.unilateral for model in self.models):
            u, multiplier, w = self._iterate(f, g, increments)
        else:
            u, multiplier, w = self._solve_tied(f, g)
        with self._timed("results"):
            states = self._iteration and self._iteration.states
            motions = [self._surface_motion(k, u) for k in range(len(self._pairs))]
            gaps = self._gaps(moved=False)
            self.results = collect_results(self.models, motions, gaps, multiplier, w, states)
        for warning in doubts(self.models, self.results, states):  # on all ranks: it may raise
            if self.comm.rank == 0:
                log.warning(warning)
        self._u = self._functions(u)
        return self.u

    def plot(self, folder: str | Path, field: str = "pressure") -> None:
        """Pictures of the last solve as PNG, without a display: bodies_0.png ... coloured by the
        displacement's length, interface_0.png ... by a field of ``plot.interface``. Collective.

        Args:
            folder: where the pictures go; it is made.
            field: "pressure", "status" or "traction".

        Raises:
            ContactError: nothing has been solved.
        """
        from dolfinx_llm.output import plot

        if not self.results:
            raise ContactError("there is nothing to draw yet: call solve() first")
        for i, u in enumerate(self._u):
            length = ufl.sqrt(ufl.inner(u, u))
            plot.bodies(u, length, Path(folder) / f"bodies_{i}.png", label="length of u")
        for i, result in enumerate(self.results):
            plot.interface(result, Path(folder) / f"interface_{i}.png", field)

    def _solve_tied(
        self, f: np.ndarray, g: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One solve of (31)."""
        if self._system is None:
            self._system = build_system(self)
        with self._timed("solve"):
            u, multiplier, v = self._system.solve(f, g)
        warn(self)
        multiplier = self._gather(self._rows.numbering, multiplier)
        for rows, basis in self._prescribed:  # the smallest that have the same effect
            multiplier[rows] = basis @ (basis.T @ multiplier[rows])
        n = sum(len(pairs.nodes) for pairs in self._pairs)
        self.history = [
            {"iteration": 1, "active": n, "stick": n, "slip": 0, "residual": self._system.residual}
        ]
        return u, multiplier, self._gather(self._frame_unknowns, v)

    def _iterate(
        self, f: np.ndarray, g: np.ndarray, increments: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Load steps of the contact laws, smaller ones where they do not converge."""
        if self._iteration is None:
            self._start_iteration()
        stage = "iteration of contact laws"
        with self._timed(stage), progress(None, stage) as self._iteration.bar:
            outcome = self._iteration.advance(f, self._gather(self._rows.numbering, g), increments)
        self.history = self._iteration.history
        return outcome

    def _start_iteration(self) -> None:
        """Set up what solves the linear steps of contact laws."""
        rows, at_rest = self._rows.numbering, np.zeros(len(self._fixed))
        with self._timed("factorisation"):
            backend = build_steps(self)
        rest = self._gather(rows, self._assemble_gap(at_rest, moved=False))
        self._iteration = ContactIteration(
            self.models, self._redundant, self.scale, backend, at_rest, rest
        )

    def reset(self) -> None:
        """Forget the last load steps: contact state, slip and loads."""
        if self._iteration is not None:
            self._iteration.forget()

    def _assemble_load(self) -> np.ndarray:
        loads = [
            compat.assemble_load(L, a, bcs, V, nodal)
            for L, a, bcs, V, nodal in zip(self._L, self._a, self._bcs, self.spaces, self._nodal)
        ]
        f = np.concatenate(loads)
        bad = self.comm.allreduce(int((~np.isfinite(f)).sum()))
        if bad:
            raise ContactError(
                f"the load has {bad} entries that are NaN or infinite. Check L, nodal_loads, the "
                "values of the Dirichlet conditions and the coefficients of the forms"
            )
        return f

    def _assemble_gap(self, f: np.ndarray, moved: bool = True) -> np.ndarray:
        """This rank's g, with the prescribed displacements, whose rows of B are empty;
        with obstacles where they are now, or as drawn."""
        g = assemble_gap(self.comm, self._pairs, self._rows.numbering, self._gaps(moved))
        values = g.array_r.copy()
        g.destroy()
        mine = self._rows.numbering.mine
        rows = self._rows.dofs[mine] - self._first
        prescribed = np.where(self._fixed[rows], f[rows], 0.0)
        values += np.einsum("ni,ni->n", self._rows.base[mine], prescribed)
        return np.where(self._redundant[mine], 0.0, values)

    def _surface_motion(self, side: int, u: np.ndarray) -> np.ndarray:
        """(n, gdim) displacement of a side's nodes, on every rank."""
        pairs, dofs = self._pairs[side], self._dofs[side]
        mine = pairs.owner == self.comm.rank
        motion = np.zeros(dofs.shape)
        motion[mine] = u[dofs[mine] - self._first]
        return self.comm.allreduce(motion)

    def _gaps(self, moved: bool = True) -> list[np.ndarray]:
        """Per side (n, gdim) the gaps that the law sees: along the normal where bodies may part."""
        gaps = []
        for model in self.models:
            for side in model.pairs:
                law, gap = model.interface.law, side.gap
                if law.unilateral:
                    gap = np.einsum("ni,ni->n", gap, side.normal)[:, None] * side.normal
                elif not law.close_gap:
                    gap = np.zeros_like(gap)
                if moved and model.interface.obstacle is not None:
                    gap = gap - model.interface.obstacle.motion(gap.shape[1])
                gaps.append(gap)
        return gaps

    def _gather(self, numbering: Numbering, local: np.ndarray) -> np.ndarray:
        """Values of all ranks in the unknowns' own order."""
        return gather_rows(self.comm, local)[numbering.number]

    def _functions(self, u: np.ndarray) -> list[fem.Function]:
        functions, first = [], 0
        for V, n in zip(self.spaces, self._sizes):
            function = fem.Function(V, name="u")
            function.x.array[:n] = u[first : first + n]
            function.x.scatter_forward()
            functions.append(function)
            first += n
        return functions

    @property
    def unknowns(self) -> dict[str, int]:
        """Global number of unknowns: displacements u, multipliers lambda, frame v."""
        return dict(self._unknowns)

    def __str__(self) -> str:
        """Anatomy: sizes, blocks present, what was left out and why."""
        n_u, n_l, n_v = self.unknowns.values()
        lines = [
            f"ContactProblem: {len(self.spaces)} mesh(es), {self.bodies.count} bodies, "
            f"{len(self.models)} interface(s), {self.comm.size} rank(s)",
            f"  unknowns: {n_u + n_l + n_v} = {n_u} u + {n_l} λ + {n_v} v",
            f"  solver: {describe_solver(self.form, self._system)} ({self._why})",
        ]
        for model in self.models:
            lines += describe(model)
        return "\n".join(lines)

    def destroy(self) -> None:
        """Free the PETSc objects; collective.

        Not left to Python's garbage collector, which runs at another time on every rank: in loops
        over many problems on several ranks call it when done with each.
        """
        for part in (self._system, self._iteration and self._iteration.backend):
            if part is not None:
                part.destroy()
        self._system = self._iteration = None
        for matrix in (self._K, self.B, self.L_b):
            if matrix is not None:
                matrix.destroy()
        self._K = None


def _layout(V: Any) -> tuple[int, ...]:
    """Number of this rank's nodes of a space, of a cell's, and of components."""
    dofmap = V.dofmap
    return dofmap.index_map.size_local, dofmap.dof_layout.num_dofs, dofmap.index_map_bs


def _argument_space(form: ufl.Form) -> Any:
    """dolfinx function space of a form's trial function."""
    arguments = form.arguments()
    if len(arguments) != 2:
        raise ContactInputError(f"the form a must be bilinear, has {len(arguments)} argument(s)")
    return arguments[0].ufl_function_space()


def _block_diagonal(blocks: list[PETSc.Mat]) -> PETSc.Mat:
    n = len(blocks)
    rows = [[blocks[i] if i == j else None for j in range(n)] for i in range(n)]
    nest = PETSc.Mat().createNest(rows, comm=blocks[0].comm)
    matrix = nest.convert("aij", PETSc.Mat())
    for M in (nest, *blocks):
        M.destroy()
    return matrix
