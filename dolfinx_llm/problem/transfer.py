"""The state of a problem carried over to another mesh of the same bodies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from dolfinx import fem, geometry
from mpi4py import MPI

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import collective
from dolfinx_llm.geometry.spaces import order_of
from dolfinx_llm.interface.against import loaded
from dolfinx_llm.operators.bodies import body_labels
from dolfinx_llm.problem.nonlinear import NonlinearContactProblem
from dolfinx_llm.problem.problem import ContactProblem
from dolfinx_llm.problem.standing import Standing

OUTLYING = 0.1  # of the largest cell of the old mesh: by how much new nodes may lie outside of it


def carry_over(old: Any, new: Any) -> None:
    """Go on from the last state of a problem on another mesh of the same bodies; collective.

    Args:
        old, new: as of ``transfer``, problems.

    Raises:
        ContactInputError, ContactError: as ``transfer`` does.
    """
    _check(old, new)
    u = found_elsewhere(old.spaces, new.spaces, [old.u if isinstance(old.u, list) else [old.u]])[0]
    if isinstance(old, NonlinearContactProblem):
        new.bulk.put(u)
        new.reset()
        _stand(old, new)
        return
    new.update()
    if (known := Standing.of(old)) is not None:  # as required
        known.go_on(new, u)


def _stand(old: NonlinearContactProblem, new: NonlinearContactProblem) -> None:
    """Put obstacles of a problem to where they stand in the last state of the old one, from where
    slip on them counts."""
    before, (now, local) = old.state_arrays()[0], new.state_arrays()
    for i, interface in enumerate(new.interfaces):
        if interface.obstacle is None:
            continue
        own, pose = f"interface {i} own", f"interface {i} pose"
        now[pose] = before[pose]
        if found := sum(loaded(interface.obstacle, new.bulk.dofs.gdim)):  # where forces bring it
            now[own] = np.append(now[own][:-found], before[own][-found:])
    new.take_arrays(now, local)


def _check(old: Any, new: Any) -> None:
    """Require problems between which a state can go over."""
    for name, problem in (("old", old), ("new", new)):
        kinds = (ContactProblem, NonlinearContactProblem)
        checks.instance(name, problem, kinds, "give a ContactProblem or a NonlinearContactProblem")
        linear = isinstance(problem, ContactProblem)
        if linear and any(order_of(V) > 1 for V in problem.spaces):
            raise ContactInputError(
                "transfer: ContactProblems of second-order bodies cannot be carried over yet: a "
                "NonlinearContactProblem of the same bodies can"
            )
        if problem.bulk.dofs.mixed:
            raise ContactInputError("transfer: problems of mixed spaces cannot be carried over yet")
    if isinstance(old, NonlinearContactProblem) and old.keeps:
        raise ContactInputError(
            "transfer: what laws of your own keep at finite deformation cannot be carried over yet"
        )
    told = [[(type(i.law).__name__, i.obstacle is None) for i in p.interfaces] for p in (old, new)]
    if type(old) is not type(new) or told[0] != told[1] or len(old.spaces) != len(new.spaces):
        raise ContactInputError(
            f"transfer: the old problem, a {type(old).__name__} of {len(old.spaces)} mesh(es) and "
            f"{told[0]}, and the new one, a {type(new).__name__} with {len(new.spaces)} and "
            f"{told[1]}, differ: give the same kind, meshes, laws and obstacles"
        )
    if old.comm.size != new.comm.size:
        raise ContactInputError("transfer: old and new problem live on other numbers of ranks")
    if isinstance(old, ContactProblem) and Standing.of(old) is None:
        raise ContactError("transfer: nothing has been solved yet: call old.solve() first")


class Elsewhere:
    """Where the nodes of a new space lie in an old mesh; body by body, for bodies touch.

    Each rank tells its nodes to the others in turn; the first whose cell is nearest answers.

    Args:
        old: vector space of the bodies.
        new: of the same bodies on another mesh; collective.

    Raises:
        ContactInputError: other bodies.
    """

    def __init__(self, old: Any, new: Any) -> None:
        self._mesh, self._comm = old.mesh, old.mesh.comm
        label, count = body_labels(old)
        wanted, wants = body_labels(new)
        cells = _own_cells(old)
        self._of = label[compat.cell_dofs(old)[: len(cells), 0]]
        self._trees: dict[int, tuple[Array, Any, Any]] = {}
        for body in np.unique(self._of):
            own = cells[self._of == body]
            middle = geometry.create_midpoint_tree(self._mesh, self._mesh.topology.dim, own)
            self._trees[int(body)] = own, compat.cell_tree(self._mesh, own), middle
        self._size = self._comm.allreduce(_largest(old, len(cells)), op=max)
        if count != wants:
            raise ContactInputError(
                f"the new mesh has {wants} connected bodies, the old one {count}: transfer carries "
                "over to another mesh of the same bodies"
            )
        self._x = _three(new.tabulate_dof_coordinates()[: new.dofmap.index_map.size_local])
        self._body = self._matched(new, wanted, count)[wanted[: len(self._x)]]

    def _matched(self, new: Any, wanted: Array, count: int) -> Array:
        """(count,) old body of each new one: in which most middles of its cells lie."""
        own = compat.cell_dofs(new)[: len(_own_cells(new))]
        middle = _three(new.tabulate_dof_coordinates())[own].mean(axis=1)
        votes = np.zeros((count, count))
        where = [self._ask(middle, np.full(len(middle), body), [])[0] for body in range(count)]
        nearest = np.argmin(where, axis=0) if len(middle) else np.zeros(0, dtype=int)
        np.add.at(votes, (wanted[own[:, 0]], nearest), 1.0)
        found = self._comm.allreduce(votes).argmax(axis=1)
        if len(np.unique(found)) < count:
            raise ContactInputError(
                "bodies of the new mesh lie where others of the old one are: transfer carries over "
                "to another mesh of the same bodies, drawn at the same places"
            )
        return found

    def values(self, functions: Sequence[fem.Function]) -> list[Array]:
        """Per Function of the old mesh (n_owned, size) values at the new nodes; collective.

        Raises:
            ContactInputError: nodes lie outside of the old mesh.
        """
        far, *found = self._ask(self._x, self._body, functions)
        out = far > OUTLYING * self._size
        each = self._comm.allgather((int(out.sum()), far.max(initial=0.0), self._x[out][:1]))
        if count := sum(part[0] for part in each):
            first = checks.place(np.concatenate([part[2] for part in each])[0])
            raise ContactInputError(
                f"{count} nodes of the new mesh lie outside of the old one, by up to "
                f"{max(part[1] for part in each):.3g}, the first at {first}; up to "
                f"{OUTLYING * self._size:.3g} is taken: draw the same bodies at the same places"
            )
        return found

    def _ask(self, x: Array, body: Array, functions: Sequence[fem.Function]) -> list[Array]:
        """Distance of this rank's points from the old bodies, and values of Functions there, 0
        where they lie outside; collective."""
        answers: list[Array] = []
        for rank in range(self._comm.size):
            points, of = self._comm.bcast((x, body), root=rank)
            far, cells = self._nearest(points, of)
            least = self._least(far)
            first = self._least(np.where(far == least, float(self._comm.rank), np.inf))
            mine = (first == self._comm.rank) & (least <= OUTLYING * self._size)
            with collective(self._comm):
                found = [_values(function, points, cells, mine) for function in functions]
            summed = [self._comm.reduce(values, root=rank) for values in found]
            if rank == self._comm.rank:
                answers = [least, *summed]
        return answers

    def _least(self, values: Array) -> Array:
        """The least of all ranks, of each of their values."""
        least = np.array(values)
        self._comm.Allreduce(MPI.IN_PLACE, least, op=MPI.MIN)
        return least

    def _nearest(self, x: Array, body: Array) -> tuple[Array, Array]:
        """Distance of points (n, 3) of any rank from this rank's cells of their bodies, infinite
        where it has none, and the nearest of these."""
        far, nearest = np.full(len(x), np.inf), np.zeros(len(x), dtype=np.int32)
        for name, (_, tree, middle) in self._trees.items():
            at = np.flatnonzero(body == name)
            if not len(at):
                continue
            cells = geometry.compute_closest_entity(tree, middle, self._mesh, x[at])
            dim = self._mesh.topology.dim
            far[at] = np.sqrt(geometry.squared_distance(self._mesh, dim, cells, x[at]))
            nearest[at] = cells
        return far, nearest


def _values(function: fem.Function, x: Array, cells: Array, at: Array) -> Array:
    """(n, size) values at those of the points (n, 3) that this rank answers for, else 0."""
    found = np.zeros((len(x), function.function_space.dofmap.index_map_bs))
    if at.any():  # only where a cell is near: far from it dolfinx finds no point of reference
        found[at] = function.eval(x[at], cells[at]).reshape(int(at.sum()), -1)
    return found


def found_elsewhere(
    old: Sequence[Any], new: Sequence[Any], fields: Sequence[Sequence[fem.Function]]
) -> list[Array]:
    """Per field, Functions of the old spaces, this rank's values (n_local,) at the new spaces'
    dofs, one space after the other; collective.

    Args:
        old, new: spaces of the bodies, in the same order.
        fields: each with a Function of every old space.

    Raises:
        ContactInputError: other bodies, or nodes that lie outside.
    """
    each = [
        Elsewhere(V, W).values(functions)
        for V, W, functions in zip(old, new, zip(*fields, strict=True), strict=True)
    ]
    return [np.concatenate([values.ravel() for values in parts]) for parts in zip(*each)]


def _own_cells(V: Any) -> Array:
    topology = V.mesh.topology
    return np.arange(topology.index_map(topology.dim).size_local, dtype=np.int32)


def _largest(V: Any, n: int) -> float:
    """Size of the largest of this rank's n cells along an axis."""
    x = V.tabulate_dof_coordinates()[compat.cell_dofs(V)[:n]]
    return float(np.ptp(x, axis=1).max(initial=0.0))


def _three(x: Array) -> Array:
    """(n, 3) of positions (n, gdim), contiguous."""
    return np.ascontiguousarray(np.pad(x, ((0, 0), (0, 3 - x.shape[1]))))
