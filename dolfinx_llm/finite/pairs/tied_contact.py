"""Ties at finite deformation: rows of the drawing, which bind x_p to sum_J N_pJ y_J for good.

These equations are linear: their forces have no derivative by positions, turn with the bodies, and
a constant pressure passes in every homogeneous deformation, since it passes in the drawing. Normals
and areas, by which forces are reported, are those of now, of the parts that were covered as drawn.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.sparse import diagonal, summing
from dolfinx_llm.finite.frame.chart import chart_of
from dolfinx_llm.finite.frame.covered import Covered
from dolfinx_llm.finite.frame.design import Design
from dolfinx_llm.finite.frame.location import OnFrame
from dolfinx_llm.finite.frame.sides import Meeting, Sides
from dolfinx_llm.finite.pairs.terms import YIELDS, Bound, ContactTerms, Held, Place
from dolfinx_llm.geometry.cells import unit
from dolfinx_llm.interface.carried import carried_rows, round_rows

DRAWN = 1e-9  # gap over facet size that is none
LITTLE_AREA = 1e-6  # of the largest area, below which nodes count alike
TELLS = 1e-2  # singular value of rows of prescribed nodes, below which they tell nothing


@dataclass(frozen=True, eq=False)
class TiedContact(Bound):
    """Unknowns: a force of gdim components per node of the moving side."""

    sides: Sides
    A: csr_matrix  # (n gdim, width) x_p - sum_J N_pJ y_J, at second order of control values
    N: csr_matrix  # (n, m)
    pairs: Array  # (n,) nodes that are tied
    drawn: Meeting  # where nodes lie and what is covered, for good
    delta: float
    z: Array  # (width,) coordinates as drawn [length]
    found: list[tuple[Array, tuple[csr_matrix, csr_matrix]]] = field(
        default_factory=list, repr=False
    )  # what ``_determined`` has found last, and for what

    @classmethod
    def of(cls, sides: Sides, z: Array, design: Design, close_gap: bool) -> TiedContact:
        """Ties of surfaces drawn at coordinates z.

        Args:
            sides, z, design: of the surfaces.
            close_gap: close gaps of the drawing.

        Raises:
            ContactError: the surfaces do not face each other.
            ContactInputError: there are gaps that are not to be closed.
        """
        candidates = sides.candidates(z)
        meeting = sides.meet(z, candidates)
        f, fy = (sides.forces(meeting, z, moving)[0] for moving in (True, False))
        on = np.flatnonzero((f > 0.0) & meeting.at.met)
        x, y = sides.split(z)
        if not len(on):
            raise ContactError(
                f"no facets of {sides.surfaces[0].name} and {sides.surfaces[1].name}, which are to "
                "be tied, face each other within the size of a facet. Check tags, positions and "
                "units"
            )
        n, found = len(x), _carried(sides, close_gap) if design.wanted else None
        far = np.abs(meeting.at.gap[on]).max(initial=0.0)
        if found is not None and sides.rounded.any():  # facets of curved surfaces are apart
            far = np.abs(x[found[0]] - found[1] @ y).max(initial=0.0)
        if not close_gap and far > DRAWN * design.size:
            raise ContactInputError(
                f"the surfaces {sides.surfaces[0].name} and {sides.surfaces[1].name} are drawn "
                f"with gaps of up to {far:.3g}: at finite deformation choose Tied(close_gap=True), "
                "or draw them in touch"
            )
        if found is None:
            at, loads = meeting.at.part(on), ((sides.control[0].T @ f)[on], sides.control[1].T @ fy)
            functions = chart_of(sides.carrier, loads[1])
            rows = design.rows(at, x[on], y, loads, functions)
            found = on, rows.matrix(len(y)), float(np.abs(rows.delta).max())
        on, own, delta = found
        N = sides.control[0] @ summing(on, n) @ own
        pairs = np.zeros(n, dtype=bool)
        pairs[on] = True
        pairs &= abs(sides.control[0]) @ ~pairs == 0.0  # and all that they are made of
        N = diagonal(pairs) @ N
        A = diagonal(np.repeat(pairs, sides.gdim)) @ sides.jumps(N)
        own, other = (Covered(c.share, csr_matrix(c.derivative.shape)) for c in meeting.covered)
        return cls(sides, A, N, pairs, replace(meeting, covered=(own, other)), delta, z)

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return int(self.A.shape[0])

    @property
    def owner(self) -> Array:
        return np.repeat(self.sides.mover.owner, self.sides.gdim)

    def carried(self, q: Array, R: Array) -> Array:
        return (q.reshape(-1, len(R)) @ R.T).ravel()

    def place(self, z: Array, q: Array, held: Held) -> Place:
        """Rows as drawn, normals and areas as they are now."""
        sides, at = self.sides, self.drawn.at
        of_facets = sides.outward(z)[sides.carrier.cells[at.facet]]
        normal = unit(np.einsum("nk,nki->ni", at.N, of_facets))
        own, frame = (sides.forces(self.drawn, z, moving)[0] for moving in (True, False))
        areas = own, sides.control[1].T @ frame
        return Place(z, np.where(self.pairs, 0.0, np.inf), normal, self.N, areas)

    def located(self, place: Place) -> OnFrame:
        return self.drawn.at

    def astray(self, place: Place, status: Array) -> Array:
        jumps = (self.A @ place.z).reshape(-1, self.sides.gdim)
        return np.asarray(np.linalg.norm(jumps, axis=1))

    def terms(self, place: Place, q: Array, status: Array, held: Held, free: Array) -> ContactTerms:
        """See ``NormalContact.terms``; q (n gdim,) are the forces on the moving side [force]."""
        width = self.sides.width
        P, rest = self._determined(free)
        A, own = (P.T @ self.A).tocsr(), rest / held.scale
        # What another interface holds as well, as a plane does, may be the same row twice.
        twice = np.repeat(held.shared, self.sides.gdim) if len(held.shared) else np.zeros(self.size)
        yielding = diagonal(YIELDS / held.scale * twice)
        return ContactTerms(
            force=A.T @ q,
            K=csr_matrix((width, width)),
            top=-A.T.tocsr(),
            left=A,
            own=own + yielding,
            rest=A @ place.z + own @ q,
            place=place,
            delta=self.delta,
            status=status,
            friction=None,
        )

    def _determined(self, free: Array) -> tuple[csr_matrix, csr_matrix]:
        """P (n gdim, n gdim) and D: P q are the forces that equilibrium determines, and D q = 0
        rules out all others.

        Where the moving side is prescribed, and has more nodes than the frame has free ones, rows
        depend on each other, or tell of frame nodes by tiny entries alone: such forces are not
        unique, or without sense. Pᵀ A z = 0 ties the prescribed nodes in the mean, and all of them
        where the frame can follow: see ``determined``.

        Args:
            free: (width,) coordinates that are not prescribed.
        """
        for known, found in self.found:
            if known is free:
                return found
        gdim = self.sides.gdim
        own, frame = self.sides.split(free)
        f = self.sides.forces(self.drawn, self.z, True)[0]
        f = np.sqrt(np.maximum(f / f.max(), LITTLE_AREA))
        tied = np.repeat(self.pairs, gdim)
        P, D = diagonal(tied).tolil(), diagonal(~tied).tolil()
        for c in range(gdim):
            on = np.flatnonzero(self.pairs & (own[:, c] == 0.0))
            if not len(on):
                continue
            rows, at = self.N[on][:, np.flatnonzero(frame[:, c])].toarray(), on * gdim + c
            P[np.ix_(at, at)], D[np.ix_(at, at)] = determined(rows, f[on])
        self.found[:] = [(free, (P.tocsr(), D.tocsr()))]
        return self.found[0][1]


def determined(rows: Array, f: Array) -> tuple[Array, Array]:
    """P and D (k, k) of prescribed nodes. With U the singular vectors of the rows f^1/2 N there,
    P = f^1/2 U Uᵀ f^-1/2 and D = f^-1/2 (1 - U Uᵀ) f^-1/2.

    Args:
        rows: (k, m) N, of what is free on the other side.
        f: (k,) roots of the nodes' areas, over the largest.
    """
    for weights in (np.ones(len(f)), f):  # as they are, where they are independent
        U, size, _ = np.linalg.svd(rows * weights[:, None], full_matrices=False)
        U = U[:, size > TELLS]
        if U.shape[1] == len(f):
            break
    UU = U @ U.T
    return weights[:, None] * UU / weights, (np.eye(len(f)) - UU) / np.outer(weights, weights)


def _carried(sides: Sides, close_gap: bool) -> tuple[Array, csr_matrix, float] | None:
    """``carried_rows`` of second-order bodies, where small corrections do; ``round_rows`` of
    first-order ones along curved surfaces."""
    surfaces = sides.mover, sides.carrier
    orders = [surface.element.order for surface in surfaces]
    try:
        if max(orders) == 1 and sides.rounded.any():
            return round_rows(*surfaces, close_gap)
        return carried_rows(*surfaces) if min(orders) == 2 else None
    except ContactError:  # rows that pass constant pressures need less
        return None
