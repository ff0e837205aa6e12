"""What the bodies are asked for: their stiffness, their load, and what has changed of these."""

import hashlib
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from dolfinx_llm.base import compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.operators.bare import check_stiffness
from dolfinx_llm.operators.control import Control
from dolfinx_llm.operators.numbering import BodyDofs
from dolfinx_llm.operators.petsc import block_diagonal
from dolfinx_llm.problem.arguments import Arguments, by_mesh, nodal_by_mesh
from dolfinx_llm.problem.form_arguments import agree_on_constants, check_positions


class Fingerprint:
    """Digests of all that the stiffness and the contact surfaces are made of: bilinear forms and
    meshes."""

    def __init__(self, forms: Sequence[ufl.Form], spaces: Sequence[Any]) -> None:
        self._comm = spaces[0].mesh.comm
        self._geometries = [V.mesh.geometry for V in spaces]
        self._coefficients = [c for form in forms for c in form.coefficients()]
        self._constants = [c for form in forms for c in form.constants()]
        self._seen: list[bytes] | None = None

    def changes(self, fixed: Iterable[Array]) -> set[str]:
        """Which data are other ones than at the call before: "stiffness", a Constant or Function of
        a form a, "conditions", the dofs that are prescribed (``fixed``, per mesh (n,) of this
        rank), or "positions" of a mesh's nodes; the same on all ranks, collective."""
        values = [c.x.array for c in self._coefficients if hasattr(c, "x")]
        values += [c.value for c in self._constants]
        now = [_digest(values), _digest(fixed), _digest(g.x for g in self._geometries)]
        before, self._seen = self._seen or now, now
        differ = np.array([a != b for a, b in zip(before, now, strict=True)], dtype=np.int64)
        names = "stiffness", "conditions", "positions"
        return {name for name, n in zip(names, self._comm.allreduce(differ)) if n}


class LinearBulk:
    """Linear bodies of UFL forms: K of a, f of L and of nodal forces.

    Attributes:
        several: whether forms came as sequences, one per mesh.
        blocks: per mesh the dofs of its form's function space.
        fixed: per mesh (n,) which of this rank's dofs are prescribed, in ``blocks``' order.
        dofs, spaces, comm: numbers of the dofs, function spaces of the displacements, communicator.
        forms, entity_maps: a, and of each dolfinx's entity maps, or None.
        version: counts the changes.

    Raises:
        ContactInputError: a form that cannot be compiled, or one that leaves bodies out.
        ContactError: the stiffness is not finite.
    """

    def __init__(self, given: Arguments, times: StageTimes) -> None:
        self.several, self.times = given.several, times
        self.blocks = given.blocks
        self._W, self.spaces = [b.W for b in self.blocks], [b.V for b in self.blocks]
        self.comm = comm = self.spaces[0].mesh.comm
        with times.timed("form compilation"), collective(comm):
            self._a = compat.forms("a", given.a, given.entity_maps)
            self._L = compat.forms("L", given.L, given.entity_maps)
        self._given, self._loads = given.bcs, given.nodal_loads
        self._all_forms = [*given.a, *given.L]
        self._K: Any = None  # see K
        self.forms, self.entity_maps = given.a, given.entity_maps
        self.look()
        self._fingerprint = Fingerprint(given.a, self.spaces)
        self._fingerprint.changes(self.fixed)
        self._pending: set[str] = set()
        self.version = 0
        self.control: Control | None = None  # of second-order surfaces that may part
        self.held: Array | None = None  # u (n_local,), where prescribed dofs stay for now

    def look(self) -> None:
        """Nodal loads and conditions by mesh, and which dofs these prescribe, as they are now;
        collective.

        Raises:
            ContactInputError: Constants that differ between ranks, other conditions than these.
        """
        agree_on_constants(self.comm, self._all_forms)
        self._nodal = nodal_by_mesh(self.comm, self._loads, self.blocks)
        self._bcs = by_mesh(self.comm, self._given, self._W)
        self._prescribed = [compat.prescribed(W, bcs) for W, bcs in zip(self._W, self._bcs)]
        found = zip(self.blocks, self._prescribed, strict=True)
        self.fixed = [b.ours(fixed[: len(b.scale)]) for b, (fixed, _) in found]
        mixed = any(b.mixed for b in self.blocks)
        others = tuple(b.others for b in self.blocks) if mixed else ()
        self.dofs = BodyDofs(self.comm, tuple(self.spaces), np.concatenate(self.fixed), others)

    def changes(self) -> set[str]:
        """What has changed since ``settle`` was called last; collective. Values of Constants and
        Functions in the forms a, which dofs the conditions prescribe, and positions of the meshes
        are looked at; K is then assembled anew. Loads and prescribed values are assembled for every
        solve."""
        self.look()
        found = self._fingerprint.changes(self.fixed)
        if "positions" in found:
            with collective(self.comm):
                for V in self.spaces:
                    check_positions(V.mesh)
        self._pending |= found
        if found:
            self.version += 1
            self.destroy()
        return self._pending

    def use_control(self, surfaces: Sequence[tuple[int, Surface]]) -> None:
        """Unknowns of the nodes of these second-order surfaces are control values from now on."""
        self.destroy()
        self.control = Control(self.dofs, surfaces) if surfaces else None

    def settle(self) -> None:
        """All that is made of K has been made anew."""
        self._pending = set()

    @property
    def K(self) -> PETSc.Mat:
        """PETSc AIJ of the stiffness, identity rows and columns at prescribed dofs; assembled anew
        when it was taken."""
        if self._K is None:
            with self.times.timed("assembly of K"):
                self._K = self._assembled()
            self._check_rows()
            if self.control is not None:
                self._K = self.control.stiffness(self._K)
            if not np.isfinite(self._K.norm()):
                self.destroy()
                raise ContactError(
                    "the stiffness has entries that are NaN or infinite. Check the coefficients of "
                    "the forms a and the mesh for degenerate cells"
                )
        return self._K

    def _assembled(self) -> PETSc.Mat:
        parts = zip(self.blocks, self._a, self._bcs, self.fixed, strict=True)
        return block_diagonal(
            [b.matrix(compat.assemble_matrix(a, bcs, 1.0), fixed) for b, a, bcs, fixed in parts]
        )

    def _check_rows(self) -> None:
        """Require that forms give all that is free some stiffness."""
        try:
            check_stiffness(self._K, self.dofs, "a")
        except ContactError:
            self.destroy()
            raise

    def take_K(self) -> PETSc.Mat:
        """K, which the bulk no longer has then."""
        K, self._K = self.K, None
        return K

    def load(self) -> Array:
        """This rank's f, with the values at prescribed dofs as ``changes`` last found them, or as
        they are ``held``."""
        if self.held is not None:
            values = np.where(self.dofs.fixed, self.held, 0.0)
            if self.control is not None:
                values = np.where(self.dofs.fixed, self.control.values(values), 0.0)
            return self._finite(np.where(self.dofs.fixed, values, self.force(values)))
        loads = []
        for i, (b, fixed) in enumerate(zip(self.blocks, self.fixed, strict=True)):
            nodal = [b.nodal(load) for load in self._nodal[i]]
            given = self._prescribed[i]
            f = compat.assemble_load(self._L[i], self._a[i], self._bcs[i], given, nodal)
            loads.append(b.load(f, fixed))
        f = self._finite(np.concatenate(loads))
        if self.control is not None:
            f = self.control.load(f, self._assembled)
        return f

    def _finite(self, f: Array) -> Array:
        """f (n_local,), required to be numbers; collective."""
        bad = self.comm.allreduce(int((~np.isfinite(f)).sum()))
        if bad:
            raise ContactError(
                f"the load has {bad} entries that are NaN or infinite. Check L, nodal_loads, the "
                "values of the Dirichlet conditions and the coefficients of the forms"
            )
        return f

    def values(self) -> Array:
        """(n_local,) prescribed displacements, as ``look`` last found them; 0 where a dof is free
        [length]."""
        of = zip(self.blocks, self._prescribed, strict=True)
        given = [b.ours(values[: len(b.scale)]) / b.scale for b, (_, values) in of]
        return np.where(self.dofs.fixed, np.concatenate(given), 0.0)

    def gradient(self, forms: Sequence[ufl.Form]) -> Array:
        """This rank's derivative (n_local,) of a functional, of linear forms in the order of the
        spaces, by what is free to move."""
        with collective(self.comm):
            compiled = compat.forms("dJ", forms, self.entity_maps)
        found = np.concatenate([
            b.ours(compat.assemble_force((c,), (1.0,), b.W)) * b.scale
            for c, b in zip(compiled, self.blocks, strict=True)
        ])  # fmt: skip
        found = found if self.control is None else self.control.forces(found)
        return np.where(self.dofs.fixed, 0.0, found)

    def force(self, u: Array) -> Array:
        """This rank's f - K u of all dofs, u (n_local,), with K as it is without the conditions:
        what bodies exert on interfaces and supports."""
        parts = []
        for i, (b, function) in enumerate(zip(self.blocks, self.functions(u), strict=True)):
            part = compat.assemble_force((self._L[i],), (1.0,), b.W)
            part = sum(map(b.nodal, self._nodal[i]), part - _product(self._a[i], function))
            parts.append(b.ours(part) * b.scale)
        force = np.concatenate(parts)
        return force if self.control is None else self.control.forces(force)

    def unbalanced(self, u: Array, pushed: Array) -> Array:
        """This rank's K u - f of nodal values u (n_local,), less what interfaces push with, as
        ``ContactProblem.pushed`` has it (n_local,): nodal forces."""
        if self.control is None:
            return -self.force(u) - pushed
        return -self.control.nodal_forces(self.force(self.control.values(u)) + pushed)

    def functions(self, u: Array) -> list[fem.Function]:
        """This rank's u (n_local,) as a Function per mesh."""
        u = u if self.control is None else self.control.nodal(u)
        functions = [fem.Function(W, name="u") for W in self._W]
        ends = np.cumsum(self.dofs.counts)
        for b, function, part in zip(self.blocks, functions, np.split(u, ends), strict=False):
            b.fill(function, part)
        return functions

    def destroy(self) -> None:
        """Free K; collective."""
        if self._K is not None:
            self._K.destroy()
        self._K = None


def _product(a: Any, u: fem.Function) -> Array:
    """Owned entries of A u, of a compiled bilinear form without conditions and a Function: what
    lifting takes from a load where all of u is prescribed."""
    dofs = u.function_space.dofmap
    every = np.arange(dofs.index_map.size_local + dofs.index_map.num_ghosts, dtype=np.int32)
    b = compat.ghosted_vector(u.function_space, dofs.index_map_bs)
    fem.petsc.apply_lifting(b, [a], [[fem.dirichletbc(u, every)]])
    return -compat.summed(b)


def _digest(arrays: Iterable[Array]) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()


def fill(functions: Sequence[fem.Function], u: Array, counts: Sequence[int]) -> None:
    """Write this rank's u (n_local,), so many dofs of each mesh, into Functions; collective."""
    for function, part in zip(functions, np.split(u, np.cumsum(counts)), strict=False):
        function.x.array[: len(part)] = part
        function.x.scatter_forward()
