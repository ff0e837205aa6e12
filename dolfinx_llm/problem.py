"""The user's door: a linear elastic problem whose bodies touch."""

from __future__ import annotations

import logging
import time
from dataclasses import replace

import numpy as np
import scipy.sparse
from dolfinx import fem
from petsc4py import PETSc

from dolfinx_llm import compat, operators
from dolfinx_llm._parallel import ContactError, ContactInputError, check, gather_rows
from dolfinx_llm.interface import Interface, build_model
from dolfinx_llm.results import STICK, InterfaceResult, SideResult
from dolfinx_llm.rigid import Bodies, check_support
from dolfinx_llm.solvers import SOLVERS, build_system, choose_solver, describe, warn
from dolfinx_llm.surface import check_space
from dolfinx_llm.system import mean_diagonal

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

    Raises:
        ContactInputError: arguments that do not fit.
        ContactError: a scene that cannot be solved.
    """

    def __init__(
        self,
        a,
        L,
        *,
        bcs=(),
        interfaces=(),
        nodal_loads=(),
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
        self._system = None
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

    def _timed(self, stage: str):
        return _Timer(self, stage)

    def _add_time(self, stage: str, seconds: float):
        self.times[stage] = self.times.get(stage, 0.0) + seconds

    def _assemble_operators(self):
        """K, B and L_b."""
        gdim = self.spaces[0].mesh.geometry.dim
        with self._timed("assembly of K"):
            blocks = [compat.assemble_matrix(a, b, 1.0) for a, b in zip(self._a, self._bcs)]
            self.K = blocks[0] if len(blocks) == 1 else _block_diagonal(blocks)
        if not np.isfinite(self.K.norm()):
            raise ContactError(
                "the stiffness has entries that are NaN or infinite. Check the coefficients of the "
                "forms a and the mesh for degenerate cells"
            )
        with self._timed("operators"):
            self._pairs = [pairs for model in self.models for pairs in model.pairs]
            spaces = [space for model in self.models for space in model.spaces]
            self._dofs = [self._global_dofs(*side) for side in zip(spaces, self._pairs)]
            self._multipliers = operators.multiplier_numbering(self._pairs, self.comm)
            frames = [model.frame for model in self.models]
            self._frame_unknowns = operators.frame_numbering(frames, self._pairs, self.comm, gdim)
            bodies = (self.K.getSizes()[0], self.K.getOwnershipRange()[0])
            self.B = operators.assemble_B(
                self.comm, self._pairs, self._dofs, self._multipliers, bodies, self._fixed
            )
            self._L_csr = [
                operators.interface_operator(model.pairs, model.directions) for model in self.models
            ]
            self._find_prescribed(bodies[1])
            kept = scipy.sparse.diags((~self._redundant).astype(float))
            L = (kept @ _block_diag(self._L_csr)).tocsr()
            L.eliminate_zeros()
            self.L_b = operators.assemble_L_b(self.comm, L, self._multipliers, self._frame_unknowns)
        self.scale = self._stiffness_scale(bodies[1])
        with self._timed("support check"):
            self._check_support()
        self.form, self._why = choose_solver(self)

    def _find_prescribed(self, start: int):
        """Rows of L_b at prescribed dofs, and the redundant ones, which (31) leaves out."""
        mine = self._multipliers.mine
        fixed = self._fixed[np.concatenate(self._dofs)[mine] - start]
        base = np.concatenate([p.base for p in self._pairs])[mine]
        prescribed = (fixed[:, None, :] | (base == 0.0)).all(axis=2)
        prescribed = self._gather(self._multipliers, prescribed).ravel()
        self._redundant = np.zeros(len(prescribed), dtype=bool)
        self._prescribed, first = [], 0
        for L in self._L_csr:
            rows, basis, redundant = operators.prescribed_rows(
                L, prescribed[first : first + L.shape[0]]
            )
            self._prescribed.append((first + rows, basis))
            self._redundant[first + redundant] = True
            first += L.shape[0]

    def _global_dofs(self, space: int, nodes) -> np.ndarray:
        """(n, gdim) numbers, in the vector of all bodies, of the dofs of pairs or a surface."""
        gdim = self.spaces[space].mesh.geometry.dim
        start = self.spaces[space].dofmap.index_map.local_range[0] * gdim
        shift = self.K.getOwnershipRange()[0] + sum(self._sizes[:space]) - start
        shift = np.array(self.comm.allgather(shift))[nodes.owner]
        return nodes.dofs[:, None] * gdim + np.arange(gdim) + shift[:, None]

    def _stiffness_scale(self, start: int) -> float:
        """Mean diagonal of K on the free surface dofs [force / length]."""
        rows = np.concatenate(self._dofs).ravel() - start
        rows = rows[(rows >= 0) & (rows < len(self._fixed))]
        return mean_diagonal(self.K, rows[~self._fixed[rows]])

    def _check_support(self):
        self.bodies = Bodies(self.spaces)
        start, gdim = self.K.getOwnershipRange()[0], self.spaces[0].mesh.geometry.dim
        labels = []
        for side, dofs in zip(self._pairs, self._dofs, strict=True):
            mine = side.owner == self.comm.rank
            label = np.zeros(len(mine), dtype=np.int64)
            label[mine] = self.bodies.label[(dofs[mine, 0] - start) // gdim]
            labels.append(self.comm.allreduce(label))
        self._check_loops(labels)
        moves = [
            np.einsum("nci,nibm->ncbm", side.base, self.bodies.modes(label, side.x))
            for side, label in zip(self._pairs, labels, strict=True)
        ]
        moves = [m.reshape(-1, *m.shape[2:]) for m in moves]
        constraints = [
            (L, np.concatenate(moves[2 * i : 2 * i + 2])) for i, L in enumerate(self._L_csr)
        ]
        check_support(self.bodies, self.K, self._fixed, constraints)

    def _check_loops(self, labels):
        """Refuse interfaces that share nodes and close a loop of bodies.

        A node may take part in several interfaces: each adds a constraint with a frame of its own.
        Round a loop (two interfaces between the same two bodies, three bodies that meet in an
        edge) the constraints repeat each other and the contact forces there are not unique.
        """
        n = len(self.models)
        group = np.arange(n)
        example = {}
        for i in range(n):
            for j in range(i):
                shared = [
                    side.x[np.isin(side.dofs, other.dofs)]
                    for side, a in zip(self.models[i].pairs, self.models[i].spaces, strict=True)
                    for other, b in zip(self.models[j].pairs, self.models[j].spaces, strict=True)
                    if a == b
                ]
                shared = np.concatenate([np.empty((0, self.models[i].frame.gdim)), *shared])
                if len(shared):
                    example[i] = len(shared), shared[0].tolist()
                    group[group == group[i]] = group[j]
        for g in np.unique(group):
            members = np.flatnonzero(group == g)
            bodies = np.unique(np.concatenate([labels[2 * i + k] for i in members for k in (0, 1)]))
            if len(members) > 1 and len(members) >= len(bodies):
                names = ", ".join(self.models[i].interface.name for i in members)
                count, at = example[members[-1]]
                raise ContactError(
                    f"{count} node(s), e.g. at {at}, take part in two interfaces, and the "
                    f"interfaces {names} close a loop of {len(bodies)} bodies: the contact forces "
                    "where they meet are not unique. Leave the facets next to the common edge out "
                    "of one interface's tag"
                )

    def solve(self):
        """Assemble the load, solve (31), and fill ``results``.

        Returns:
            The displacement: a dolfinx Function, or a list of them for several meshes.

        Raises:
            ContactError: NaN in the load, or a system that cannot be solved.
        """
        with self._timed("assembly of f"):
            f = self._assemble_load()
        if self._system is None:
            with self._timed("factorisation"):
                self._system = build_system(self)
        g = self._assemble_gap(f)
        with self._timed("solve"):
            u, multiplier, v = self._system.solve(f, g)
        warn(self)
        n = sum(len(pairs.nodes) for pairs in self._pairs)
        self.history = [
            {"iteration": 1, "active": n, "stick": n, "slip": 0, "residual": self._system.residual}
        ]
        self._store(u, multiplier, v)
        functions = self._functions(u)
        return functions if self._several else functions[0]

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

    def _assemble_gap(self, f: np.ndarray) -> np.ndarray:
        """This rank's g, with the prescribed displacements, whose rows of B are empty."""
        gaps = [
            side.gap if model.interface.law.close_gap else np.zeros_like(side.gap)
            for model in self.models
            for side in model.pairs
        ]
        g = operators.assemble_gap(self.comm, self._pairs, self._multipliers, gaps)
        values = g.array_r.copy()
        g.destroy()
        mine = self._multipliers.mine
        rows = np.concatenate(self._dofs)[mine] - self.K.getOwnershipRange()[0]
        prescribed = np.where(self._fixed[rows], f[rows], 0.0)
        base = np.concatenate([p.base for p in self._pairs])[mine]
        values += np.einsum("nci,ni->nc", base, prescribed).ravel()
        redundant = self._redundant.reshape(-1, base.shape[1])[mine].ravel()
        return np.where(redundant, 0.0, values)

    def _gather(self, numbering, local: np.ndarray) -> np.ndarray:
        """(items, bs) values of all ranks in the items' own order."""
        return gather_rows(self.comm, local.reshape(-1, numbering.bs))[numbering.number]

    def _store(self, u, multiplier, v):
        multiplier = self._gather(self._multipliers, multiplier).ravel()
        for rows, basis in self._prescribed:  # the smallest that have the same effect
            multiplier[rows] = basis @ (basis.T @ multiplier[rows])
        multiplier = multiplier.reshape(-1, self._multipliers.bs)
        v = self._gather(self._frame_unknowns, v)
        mine = self._multipliers.mine
        rows = np.concatenate(self._dofs)[mine] - self.K.getOwnershipRange()[0]
        surface_u = self._gather(
            operators.Numbering(self._multipliers.owner, self.comm.rank, rows.shape[1]), u[rows]
        )
        self.results, first, node = [], 0, 0
        for model in self.models:
            sides = []
            v_frame = np.einsum("md,mdi->mi", v[node : node + len(model.frame.x)], model.directions)
            node += len(model.frame.x)
            for pairs in model.pairs:
                rows = slice(first, first + len(pairs.nodes))
                first = rows.stop
                sides.append(_side_result(pairs, multiplier[rows], surface_u[rows], v_frame))
            frame = replace(model.frame, v=v_frame)
            force = model.pairs[0].N.T @ sides[0].normal_force
            area = model.pairs[0].N.T @ sides[0].area
            self.results.append(
                InterfaceResult(frame, tuple(sides), model.certificate, force, area)
            )

    def _functions(self, u: np.ndarray):
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
        n_l, n_v = self.L_b.getSize()
        return {"u": self.K.getSize()[0], "lambda": n_l, "v": n_v}

    def __str__(self) -> str:
        """Anatomy: sizes, blocks present, what was left out and why."""
        n_u, n_l, n_v = self.unknowns.values()
        lines = [
            f"ContactProblem: {len(self.spaces)} mesh(es), {self.bodies.count} bodies, "
            f"{len(self.models)} interface(s), {self.comm.size} rank(s)",
            f"  unknowns: {n_u + n_l + n_v} = {n_u} u + {n_l} λ + {n_v} v",
            f"  solver: {describe(self.form, self._system)} ({self._why})",
        ]
        for model in self.models:
            c, q = model.certificate, model.frame.quality
            lines += [
                f"  interface {model.interface.name}, {model.interface.law}: "
                f"{len(model.pairs[0].nodes)} + {len(model.pairs[1].nodes)} nodes in contact, "
                f"frame of {len(model.frame.x)} nodes, area {model.area:.9g}",
                f"    patch residual {c.residual:.1e} (before design {c.residual_before:.1e}), "
                f"singular values of L_b {c.singular_values[0]:.3g} to "
                f"{c.singular_values[1]:.3g}, linear fields to {c.linear:.1e}",
                f"    frame: angles {q.min_angle:.1f}° to {q.max_angle:.1f}°, shortest side "
                f"{q.min_side:.3g}",
                *(f"    {note}" for note in model.notes),
                "    left out: active set and local bases (tied)",
            ]
        return "\n".join(lines)

    def destroy(self) -> None:
        """Free the PETSc objects; collective.

        Not left to Python's garbage collector, which runs at another time on every rank: in loops
        over many problems on several ranks call it when done with each.
        """
        if self._system is not None:
            self._system.destroy()
            self._system = None
        for matrix in (self.K, self.B, self.L_b):
            matrix.destroy()


class _Timer:
    def __init__(self, problem, stage):
        self.problem, self.stage = problem, stage

    def __enter__(self):
        self.start = time.perf_counter()

    def __exit__(self, *_):
        self.problem._add_time(self.stage, time.perf_counter() - self.start)


def _layout(V) -> tuple[int, ...]:
    """Number of this rank's nodes of a space, of a cell's, and of components."""
    dofmap = V.dofmap
    return dofmap.index_map.size_local, dofmap.dof_layout.num_dofs, dofmap.index_map_bs


def _argument_space(form):
    """dolfinx function space of a form's trial function."""
    arguments = form.arguments()
    if len(arguments) != 2:
        raise ContactInputError(f"the form a must be bilinear, has {len(arguments)} argument(s)")
    return arguments[0].ufl_function_space()


def _block_diagonal(blocks):
    n = len(blocks)
    rows = [[blocks[i] if i == j else None for j in range(n)] for i in range(n)]
    return PETSc.Mat().createNest(rows, comm=blocks[0].comm).convert("aij", PETSc.Mat())


def _block_diag(matrices):
    from scipy.sparse import block_diag

    return block_diag(matrices, format="csr")


def _side_result(pairs, multiplier, u, v) -> SideResult:
    """Forces, gap and slip of one side from its multipliers (n, c), u (n, gdim) and frame v."""
    force = np.einsum("nc,nci->ni", multiplier, pairs.base)
    motion = u - pairs.N @ v
    normal_motion = np.einsum("ni,ni->n", motion, pairs.normal)
    return SideResult(
        x=pairs.x,
        u=u,
        force=force,
        normal=pairs.normal,
        normal_force=np.einsum("ni,ni->n", force, pairs.normal),
        gap=-normal_motion,
        slip=motion - normal_motion[:, None] * pairs.normal,
        status=np.full(len(u), STICK),
        area=pairs.forces,
    )
