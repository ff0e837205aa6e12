"""B, L_b and g of all interfaces of a problem, for one geometry."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy.sparse
from petsc4py import PETSc
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.parallel import chosen, gather_rows
from dolfinx_llm.base.sparse import beside
from dolfinx_llm.base.timing import StageTimes
from dolfinx_llm.interface.against import prescribed_loads
from dolfinx_llm.interface.control import control_values, controlled
from dolfinx_llm.interface.geometry import InterfaceGeometry, describe
from dolfinx_llm.operators.assemble import (
    assemble_B,
    assemble_L_b,
    frame_operator,
    given_gaps,
    in_rows,
)
from dolfinx_llm.operators.bodies import Bodies
from dolfinx_llm.operators.both_sides import held_on_both_sides
from dolfinx_llm.operators.floating import Floating
from dolfinx_llm.operators.numbering import (
    BodyDofs,
    Numbering,
    Rows,
    frame_numbering,
    places,
    slip_numbering,
)
from dolfinx_llm.operators.petsc import diagonal_of
from dolfinx_llm.operators.prescribed import NEARLY_FIXED, acting_on, free_parts, in_loops, repeated
from dolfinx_llm.operators.stiffness import side_stiffness, surface_stiffness
from dolfinx_llm.operators.support import NAMED, Constraints, floating_motions, movers

CONTRADICTED = (
    "Tied(gap=...) where both sides are prescribed along the normal, or where several interfaces "
    "meet: rows there follow from others, and gaps could contradict them"
)
FLUSH = 64.0 * float(np.finfo(float).eps)  # of positions, that rounding makes of no gap


class ContactOperators:
    """What the interfaces put into (31), for one geometry of theirs; K is only read.

    Collective. Arrays named by rows or unknowns hold those of all ranks, on every rank.

    Attributes:
        comm, geometries, dofs, tied: as given; whether ties are all there is.
        pairs: ``ContactPairs`` of every side.
        side_dofs: per side (n, gdim) numbers of its nodes' dofs in the vector of all bodies.
        places: per interface its ``Place`` in all vectors.
        rows: the multipliers: base vectors, dofs and numbers.
        frames, unknowns: ``Numbering`` of the frame unknowns v, and of w: v and the slips κ.
        blocks: per interface its L_b as csr (rows, frame unknowns).
        B, L: of (31), PETSc AIJ, rows at prescribed dofs zero; L_b as csr of all.
        soft, both: (n,) rows at dofs that are prescribed, or nearly so; on both sides, but of ties.
        loops: (n,) rows of laws that open or slip, of nodes of several interfaces, of which some
            follow from the others as long as all stick. All of them give way to changes alone, so
            that λ is that of least change: which of them would be left out is not to matter.
        held: (n,) rows at dofs that are prescribed.
        free: (n, gdim) base vectors at dofs that are not.
        interfaces_at: (n,) to how many interfaces, and pieces of one, each row's node belongs.
        idle, pins: (n,) rows where supports hold both sides, left out too; those that hold frames.
        redundant: (n,) rows of ties that follow from others, or nearly, at prescribed dofs and
            where several interfaces meet; they are left out of what is solved.
        bodies: connected bodies and their rigid motions.
        scale: mean stiffness of the surfaces, the unit of λ in the solvers [force / length].
        stiffness: per interface that of its sides [force / length].
        diagonal: (n_local,) of K [force / length].
        floating: rigid motions that need contact to be held; none where ties hold all.
        firm: whether supports and ties hold all bodies, whatever springs do.

    Raises:
        ContactError: there are ties alone, and they and supports leave a motion free.
    """

    def __init__(
        self,
        geometries: Sequence[InterfaceGeometry],
        dofs: BodyDofs,
        K: PETSc.Mat,
        times: StageTimes,
    ) -> None:
        self.comm, self.geometries, self.dofs = dofs.comm, list(geometries), dofs
        for geometry in geometries:
            times.add(geometry.times)
        with times.timed("operators"):
            self._number()
            self.B = assemble_B(self.rows, dofs)
            self.L = beside(self.blocks)
            self._find_repeated()
        with times.timed("support check"):
            self.bodies = Bodies(dofs.spaces, dofs.of_nodes, controlled(geometries))
        self.renew(K, times)

    def renew(self, K: PETSc.Mat, times: StageTimes) -> None:
        """Take over another stiffness of the same bodies, which must hold them."""
        self.diagonal = of_K = diagonal_of(K)
        self.scale = surface_stiffness(self.dofs, of_K, self.rows, self.tied)
        sides = side_stiffness(self.dofs, of_K, self.side_dofs, self.scale)
        self.stiffness = [sides[place.sides] for place in self.places]
        with times.timed("support check"):
            self._check_support(K)

    @cached_property
    def L_b(self) -> PETSc.Mat:
        """L_b of (31) as PETSc AIJ, collective where it is asked for first: what is solved needs
        that of ``L``."""
        return assemble_L_b(self.comm, self.L, self.rows.numbering, self.frames)

    def _number(self) -> None:
        """Places, rows, unknowns, and L_b of each interface."""
        self.tied = all(g.interface.law.ties for g in self.geometries)
        self.pairs = [pairs for g in self.geometries for pairs in g.pairs]
        spaces = [space for g in self.geometries for space in g.spaces]
        self.side_dofs = [self.dofs.of(*side) for side in zip(spaces, self.pairs, strict=True)]
        self.places = places(self.geometries)
        self.rows = Rows.of(self.comm, self.pairs, self.side_dofs)
        self.frames = frame_numbering(self.geometries, self.comm)
        self.unknowns = slip_numbering(self.geometries, self.frames)
        self.blocks = [frame_operator(geometry) for geometry in self.geometries]

    def _find_repeated(self) -> None:
        """Rows at prescribed dofs and at nodes of several interfaces, and those of ties among them
        that follow from others, which what is solved leaves out."""
        mine = self.rows.numbering.mine
        fixed = self.dofs.fixed[self.rows.dofs[mine] - self.dofs.first]
        free = np.where(fixed, 0.0, self.rows.base[mine])
        self.free = free = self.gather(self.rows.numbering, free)
        self.held = ~free.any(axis=1)
        each = [g.pairs[0].base.shape[1] for g in self.geometries]  # rows of a pair
        nodes = [self.rows.dofs[p.rows, 0][::c] for p, c in zip(self.places, each, strict=True)]
        known, count = np.unique(np.concatenate(nodes), return_counts=True)
        self.interfaces_at = count[np.searchsorted(known, self.rows.dofs[:, 0])]
        sides = zip(self.geometries, self.places, strict=True)
        own = [free_parts(free[place.rows], g.pairs[0].base.shape[1]) for g, place in sides]
        self.soft = np.concatenate(own) < NEARLY_FIXED
        ties, self.redundant, self.loops, self.idle, self.pins = np.zeros((5, len(self.held)), bool)
        for geometry, place in zip(self.geometries, self.places, strict=True):
            ties[place.rows] = geometry.interface.law.ties
        shared = self.held | (self.interfaces_at > 1)
        rows = np.flatnonzero(ties & shared)
        if len(rows):
            said, gaps = self._said(rows), self.row_gaps()[rows]
            joints = self.interfaces_at[rows] > 1
            self.redundant[rows] = chosen(self.comm, lambda: repeated(said, gaps, joints))
        if not self.tied:
            rest = np.flatnonzero(shared & ~self.redundant & ~self.soft)
            loops = chosen(self.comm, lambda: in_loops(self._said(rest)))
            self.loops[rest] = loops & ~ties[rest]
        of = self.geometries, self.places, self.dofs, self.side_dofs, self.soft
        self._both, self.both = held_on_both_sides(*of)

    def _said(self, rows: Array) -> csr_matrix:
        """What some rows (k,) say of frames and of free dofs."""
        return scipy.sparse.hstack([self.L[rows], self.at_free_dofs(rows)], format="csr")

    def at_free_dofs(self, rows: Array) -> csr_matrix:
        """(k, dofs) forces at the free dofs of nodes from those of some rows (k,)."""
        return acting_on(self.rows.dofs[rows], self.free[rows])

    def _check_support(self, K: PETSc.Mat) -> None:
        """Require that supports and ties hold every body, if these are all there is."""
        of = self.bodies, K, self.dofs.fixed, lambda: _constraints(self), self.tied
        rigid, loose, self.firm = floating_motions(*of)
        self.floating = Floating(rigid, self.B, self.rows.numbering, loose)

    @property
    def counts(self) -> dict[str, int]:
        """Global number of unknowns: displacements u, multipliers lambda, frame v."""
        rows, frames = self.rows.numbering.sizes[1], self.frames.sizes[1]
        return {"u": self.dofs.sizes[1], "lambda": rows, "v": frames}

    def gather(self, numbering: Numbering, local: Array) -> Array:
        """Values of all ranks in the unknowns' own order, from this rank's (n_local, ...)."""
        return gather_rows(self.comm, local)[numbering.number]

    def motion(self, side: int, u: Array) -> Array:
        """(n, gdim) displacement of a side's nodes, on every rank, from this rank's u."""
        return self.dofs.values(self.side_dofs[side], u)

    def obstacle_motions(self) -> list[Array]:
        """Per interface (n, gdim) prescribed motion of an obstacle at the points that its pairs
        touch; one row of zeros for a frame, which moves by v [length]."""
        found = []
        for geometry in self.geometries:
            obstacle, pairs = geometry.interface.obstacle, geometry.pairs[0]
            none = np.zeros_like(pairs.x[:1])
            moved = none if obstacle is None else control_values(pairs, obstacle.motion(pairs.met))
            found.append(moved)
        return found

    def frame_loads(self) -> Array:
        """(n_v,) loads on the frame unknowns: zero but for forces on obstacles [force]."""
        loads = np.zeros(self.frames.sizes[1])
        for geometry, place in zip(self.geometries, self.places, strict=True):
            loads[place.frame] = prescribed_loads(geometry)
        return loads

    def side_gaps(self, motions: Sequence[Array] | None = None) -> list[Array]:
        """Per side (n, gdim) the gaps that the law sees, along the normal: with obstacles
        moved as of ``obstacle_motions``, or as drawn."""
        gaps = []
        for i, geometry in enumerate(self.geometries):
            for side in geometry.pairs:
                law, gap = geometry.interface.law, side.gap
                gap = np.where(np.abs(gap) > FLUSH * np.abs(side.x).max(initial=0.0), gap, 0.0)
                if not geometry.rigid:  # along the surface rows miss their nodes: no gap to close
                    gap = np.einsum("ni,ni->n", gap, side.normal)[:, None] * side.normal
                gap = gap * law.closes_gap
                gaps.append(gap if motions is None else gap - motions[i])
        return [gap + given for gap, given in zip(gaps, given_gaps(self.geometries), strict=True)]

    def row_gaps(self, motions: Sequence[Array] | None = None) -> Array:
        """(n,) a_i · (X_p - sum_J N_J Y_J) of all rows, from the gaps of ``side_gaps``."""
        return in_rows(self.pairs, self.side_gaps(motions))

    def gap(self, prescribed: Array, motions: Sequence[Array] | None = None) -> Array:
        """This rank's g, with the displacements (n_local,) at prescribed dofs, whose rows of B are
        empty; obstacles moved as of ``obstacle_motions``, or as drawn."""
        if in_rows(self.pairs, given_gaps(self.geometries))[self.redundant].any():
            raise ContactInputError(CONTRADICTED)
        mine = self.rows.numbering.mine
        for both in self._both:
            given = np.where(self.dofs.fixed, prescribed, 0.0)
            rest = both.rest([self.motion(side, given) for side in both.sides])
            self.idle[both.rows], self.pins[both.rows] = rest
        at = self.rows.dofs[mine] - self.dofs.first
        known = np.where(self.dofs.fixed[at], prescribed[at], 0.0)
        return self.row_gaps(motions)[mine] + np.einsum("ni,ni->n", self.rows.base[mine], known)

    def destroy(self) -> None:
        """Free B and L_b; collective."""
        self.B.destroy()
        if "L_b" in self.__dict__:
            self.L_b.destroy()


def anatomy(operators: ContactOperators) -> list[str]:
    """Lines for ``print(problem)``: what is left out of (31), and the interfaces."""
    repeated = int(operators.redundant.sum())
    text = (
        f"  left out: {repeated} multiplier(s) whose rows follow from others, at supports or where "
        "several interfaces meet; of all forces with the same effect the least are given"
    )
    meets = operators.loops & ~operators.redundant
    names = [
        g.interface.name
        for g, place in zip(operators.geometries, operators.places, strict=True)
        if meets[place.rows].any()
    ]
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    shared = (
        f"  not unique where interfaces meet, as long as all press and stick there: how forces are "
        f"shared by {', '.join(names[:NAMED])}{more}; they change least from load step to load step"
    )
    floating = operators.floating
    loose = []
    if floating.loose.count:
        loose = [
            f"  taken as zero: {floating.loose.count} rigid motion(s) that supports and interfaces "
            f"leave open, on which no load may do work; they move "
            f"{movers(floating.rigid, floating.loose)}"
        ]
    lines = [line for geometry in operators.geometries for line in describe(geometry)]
    return [text] * bool(repeated) + [shared] * bool(names) + loose + lines


def _constraints(operators: ContactOperators) -> Constraints:
    """Per interface L_b, None without a frame, and Bᵀ of the bodies' rigid motions."""
    bodies, moves, labels = operators.bodies, [], operators.dofs.spread(operators.bodies.label)
    for side, dofs in zip(operators.pairs, operators.side_dofs, strict=True):
        label = operators.dofs.values(dofs[:, 0], labels)
        modes = bodies.own_modes(label.astype(np.int64), side.places)
        move = np.einsum("nci,nim->ncm", side.base, modes)
        n, c, m = move.shape
        first = np.broadcast_to(m * label.astype(np.int64)[:, None, None], move.shape)
        columns = (first + np.arange(m)).ravel(), m * np.arange(n * c + 1)
        moves.append(csr_matrix((move.ravel(), *columns), (n * c, m * bodies.count)))
    return [
        (L if L.shape[1] else None, scipy.sparse.vstack(moves[place.sides], format="csr"))
        for place, L in zip(operators.places, operators.blocks, strict=True)
    ]
