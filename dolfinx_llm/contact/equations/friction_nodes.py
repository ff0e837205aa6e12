"""Between pairs, which carry the multipliers, and the nodes at which a law holds.

These are the frame's nodes: both sides jump by κ about the frame, (13), u_0 = v + κ, u_1 = v - κ.
The force is then T = L_kappaᵀ λ / 2 and the jump 2 κ; theta is that 1/2. Or they are the pairs of
one side, which jump by κ from a rigid obstacle, or from a frame that the other side carries; theta
is 1 then.

A side carries the frame along curved surfaces with friction. At the rim of contact corrected rows
of coarse facets hold a frame node by far ends of shape functions, which tell no slip: a law at the
frame's nodes then has no state to come to rest in, or several. Pairs have a slip of their own each,
and the tangential rows of the side that carries the frame stay closed where contact is open.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from mpi4py import MPI
from scipy.sparse import csr_matrix, hstack, vstack

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.base.sparse import diagonal, nearest, of_nearest, renumbered
from dolfinx_llm.geometry.spaces import is_function
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.rows import OPEN, at_positions
from dolfinx_llm.operators.assemble import interface_operator
from dolfinx_llm.operators.both_sides import along_supports
from dolfinx_llm.operators.numbering import Place
from dolfinx_llm.operators.stiffness import in_series
from dolfinx_llm.operators.system import ContactOperators

FLOOR = 1e-3  # what pairs without contact add to the support of a node
RUBS = 1e-9  # of the level of forces: friction with less is none
TOUCHED = 1e-9  # shape function from which on a pair belongs to a node


@dataclass(frozen=True, eq=False)
class FrictionNodes:
    """Of one interface: its places in the vectors of all, and the operators of its law; n pairs
    with c multipliers each, k nodes with jumps of q components, none where the law has no jumps."""

    geometry: InterfaceGeometry
    rows: Array  # (n, c) its multiplier rows
    v: Array  # (m d,) its frame unknowns
    kappa: Array  # (k, q) its jump unknowns
    operators: ContactOperators  # of all interfaces
    yields: Array  # (n,) pairs that supports leave free to move tangentially
    L: csr_matrix  # (n c, m d)
    L_kappa: csr_matrix  # (n c, k q)
    L_normal: csr_matrix  # (k, n c) normal force at the nodes from λ
    theta: float
    softer: float  # stiffness of its sides in series, over that of all surfaces
    x: Array  # (k, gdim) positions as drawn [length]
    area: Array  # (k,) tributary area
    sample: Callable[[Any], Array]  # (k,) of what users give for a law, see ``LawNodes``

    @property
    def law(self) -> Law:
        """Of the interface."""
        return self.geometry.interface.law

    @property
    def comm(self) -> MPI.Comm:
        """Of the bodies."""
        return self.operators.dofs.comm

    @property
    def tangents(self) -> Array:
        """(k, t, gdim) at the law's nodes."""
        return self.geometry.law_directions[:, :-1]

    @property
    def N(self) -> tuple[csr_matrix, ...]:
        """Per side (n_i, k) shape functions of the pairs."""
        return self.geometry.law_shapes

    @property
    def kept(self) -> Array:
        """(n c,) rows that are not left out."""
        rows, operators = self.rows.ravel(), self.operators
        return ~(operators.redundant[rows] | operators.idle[rows])

    @property
    def seen(self) -> Array:
        """(k,) nodes along whose jumps rows act that are not left out."""
        return self.reached(self.kept.reshape(self.rows.shape)[:, :-1].any(axis=1))

    @property
    def carries(self) -> Array:
        """(n,) pairs of the side that carries the frame, if there is one."""
        return self.geometry.carries

    def seen_by(self, held: Array) -> csr_matrix:
        """(n c, m d) L as supports see the frame, by rows (n c,) that they hold it by, if any."""
        return self._L_across if held.any() else self.L

    @cached_property
    def _L_across(self) -> csr_matrix:
        """(n c, m d) L of the rows' parts along dofs that supports prescribe: what they bear."""
        of, rows = self.geometry, self.rows.ravel()
        sides = along_supports(of.pairs, self.operators.free[rows], np.ones(len(rows), dtype=bool))
        return interface_operator(sides, of.directions, of.normals_alone)

    @cached_property
    def frame_support(self) -> Array:
        """(m,) how firmly all pairs hold the motion of the frame's nodes: sums of N²."""
        return np.sum([p.N.power(2).sum(axis=0).A1 for p in self.geometry.pairs], axis=0)

    @cached_property
    def _nearest(self) -> csr_matrix:
        """(n, k) 1 at the node next to each pair, at both where it lies in the middle."""
        return nearest(self._linked).astype(bool)

    @cached_property
    def _linked(self) -> csr_matrix:
        """(n, k) the part that pairs have in nodes; of those that carry the frame, which have none
        of their own, by way of it."""
        if not self.carries.any():
            return self._parts
        N = abs(vstack([p.N for p in self.geometry.pairs])).tocsr()
        return (self._parts + diagonal(self.carries) @ N @ N[~self.carries].T).tocsr()

    def next_to(self, status: Array) -> Array:
        """(n,) status (k,) of the node next to each pair: between two that of the larger number,
        since rounding must not decide; of pairs that carry the frame of the node in contact next
        to them, as rows beyond an outline have large parts in them."""
        if not self.carries.any():
            return of_nearest(self._nearest, status)
        return of_nearest(nearest(self._linked @ diagonal(status != OPEN)).astype(bool), status)

    @cached_property
    def _parts(self) -> csr_matrix:
        """(n, k) the part that pairs have in nodes."""
        return abs(vstack(self.N)).tocsr()

    @cached_property
    def _squares(self) -> list[tuple[csr_matrix, float]]:
        """Per side N² (k, n_i), and the least that counts as held."""
        squares = [N.power(2).T.tocsr() for N in self.N]
        return [(s, FLOOR * s.sum() / s.shape[0]) for s in squares]

    @cached_property
    def led(self) -> Array:
        """(k,) nodes whose tangential motion supports prescribe."""
        return self._linked.T @ self.yields.astype(float) <= TOUCHED

    def holding(self, active: Array) -> Array:
        """(n,) pairs in contact, and those that hold the frame tangentially where others are, in
        contact or not.

        Args:
            active: (n,) pairs in contact.
        """
        if not self.carries.any():
            return active
        own = active[~self.carries].astype(float)
        return active | (self.carries & (self._linked @ own > TOUCHED))

    def felt(self, forces: Array, level: float) -> csr_matrix:
        """(n c, k q or k (q + 1)) what the law's nodes feel of forces (n c,), which are of a level
        [force]: along their jumps, and where any rub, which they share, the normal ones."""
        rubs = np.abs(self.tangential @ forces).max(initial=0.0) > RUBS * level
        return hstack([self.L_kappa, self.L_normal.T], format="csr") if rubs else self.L_kappa

    @cached_property
    def tangential(self) -> csr_matrix:
        """(k q, n c) forces along the jumps of the multipliers."""
        return self.theta * self.L_kappa.T.tocsr()

    def of(self, pairs: Array) -> list[csr_matrix]:
        """Per side (n_i, k) shape functions of some of the pairs (n,)."""
        ends = np.cumsum([part.shape[0] for part in self.N])
        chosen = np.split(pairs.astype(float), ends[:-1])
        return [diagonal(a) @ part for a, part in zip(chosen, self.N, strict=True)]

    def reach(self, nodes: Array) -> Array:
        """(n,) pairs that some nodes (k,) have a part in."""
        if not nodes.any():
            return np.zeros(len(self.rows), dtype=bool)
        return np.asarray(self._parts @ nodes.astype(float)).ravel() > TOUCHED

    def reached(self, pairs: Array) -> Array:
        """(k,) nodes that have a part in some pairs (n,)."""
        if not pairs.any():
            return np.zeros(len(self.kappa), dtype=bool)
        return np.asarray(self._parts.T @ pairs.astype(float)).ravel() > TOUCHED

    def support(self, weight: Array) -> list[Array]:
        """Per side (k,) how firmly pairs of a weight (n,) hold the motion of nodes: sums of N²."""
        first, out = 0, []
        for squares, least in self._squares:
            n = squares.shape[1]
            out.append(np.maximum(squares @ weight[first : first + n], least))
            first += n
        return out

    def operator(self, of_rows: csr_matrix, n_all: int) -> csr_matrix:
        """A matrix (a, n c) of the own multipliers as (a, n_all) of all."""
        own, first = of_rows.tocsr(), self.rows[0, 0]
        if own.shape[1] == n_all:
            return own
        return renumbered(own, first + np.arange(own.shape[1]), n_all)


def friction_nodes(operators: ContactOperators) -> list[FrictionNodes]:
    """Of all interfaces."""
    of = zip(
        operators.geometries, operators.places, operators.blocks, operators.stiffness, strict=True
    )
    return [_friction_nodes(operators, *each) for each in of]


def _friction_nodes(
    operators: ContactOperators,
    geometry: InterfaceGeometry,
    place: Place,
    L: csr_matrix,
    stiffness: Array,
) -> FrictionNodes:
    n, c, gdim = sum(len(p.nodes) for p in geometry.pairs), *geometry.pairs[0].base.shape[1:]
    rows, jumps = (np.arange(at.start, at.stop) for at in (place.rows, place.slips))
    q = geometry.interface.law.jumps(gdim)
    x, area = (a if q else a[:0] for a in geometry.law_nodes)
    L_kappa, L_normal, theta = _jump_operators(geometry, n, c, gdim)
    return FrictionNodes(
        geometry,
        rows=rows.reshape(n, c),
        v=np.arange(place.frame.start, place.frame.stop),
        kappa=jumps.reshape(-1, max(q, 1)),
        operators=operators,
        yields=~operators.soft[place.rows].reshape(n, c)[:, :-1].all(axis=1),
        L=L,
        L_kappa=L_kappa,
        L_normal=L_normal,
        theta=theta,
        softer=in_series(stiffness) / operators.scale,
        x=x,
        area=area,
        sample=lambda value: _sampled(operators, geometry, place, x, value),
    )


def _jump_operators(
    geometry: InterfaceGeometry, n: int, c: int, gdim: int
) -> tuple[csr_matrix, csr_matrix, float]:
    """L_kappa (n c, k q), N (k, n c) of the multipliers, and θ."""
    law = geometry.interface.law
    if not law.jumps(gdim):
        return csr_matrix((n * c, 0)), csr_matrix((0, n * c)), 1.0
    # Both sides jump by κ in their own base, (13).
    shapes = zip(geometry.pairs, geometry.law_shapes, (1.0, -1.0))
    sides = [replace(p, N=N, base=sign * p.base) for p, N, sign in shapes]
    normals, theta = geometry.law_directions[:, -1:], geometry.theta
    across = interface_operator(sides, normals, geometry.normals_alone)
    jumps = interface_operator(sides, geometry.jump_directions, geometry.normals_alone)
    if not law.gives:
        # Slip moves no pair along its own normal, however coarse a curved frame is, and pairs'
        # normal forces are no friction.
        own = np.tile(np.arange(c) == c - 1, n)
        across, jumps = diagonal(own) @ across, diagonal(~own) @ jumps
    return jumps, theta * across.T.tocsr(), theta


def _sampled(
    operators: ContactOperators,
    geometry: InterfaceGeometry,
    place: Place,
    x: Array,
    value: Any,
) -> Array:
    """(k,) of what a user gives for a law at x (k, gdim), see ``LawNodes``; collective."""
    if not is_function(value):
        carried = geometry.site.carrier is not None
        if carried and np.shape(value) == (geometry.shares.shape[1],):  # given at the frame's nodes
            return geometry.shares @ at_positions(value, x)
        return at_positions(value, x)
    found = []
    for side, space in zip(
        range(place.sides.start, place.sides.stop), geometry.spaces, strict=True
    ):
        V = operators.dofs.spaces[space]
        if value.function_space.mesh is V.mesh:
            nodal = operators.dofs.sampled(value, space, operators.side_dofs[side][:, 0])
            pairs = operators.pairs[side]
            found.append(nodal if geometry.rigid else pairs.interpolation(x) @ nodal)
    if not found:
        raise ContactInputError(
            f"interface {geometry.interface.name}: a Function that a law varies by lives on the "
            "mesh of neither side. Give one of a side's mesh, or a function of positions"
        )
    return np.mean(found, axis=0)
