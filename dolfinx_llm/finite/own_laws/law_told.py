"""What a law of one's own is told of the moving side's nodes, and what it keeps.

The law of ``laws.law`` is told of these nodes what it is told of frame nodes at small sliding: the
area of each that is covered now, by which it should make forces of tractions, the force of side 0
on side 1, and the jump: along the normal the overlap now, or its growth since the drawing where the
gap as drawn does not count; along the surface the sum of what increments slipped, each measured as
under friction, in a base that is carried along.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.finite.own_laws.law_rows import Linear, Tangents, linear
from dolfinx_llm.finite.pairs.friction import Friction, tangential
from dolfinx_llm.finite.pairs.terms import Held
from dolfinx_llm.laws.answers import kept_by
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.rows import CLOSED, OPEN, LawNodes

PULLS = 1e-9  # force over stiffness times facet size below which it is none


@dataclass(frozen=True, eq=False)
class Kept:
    """What a law keeps from increment to increment."""

    history: dict[str, Array]  # (n, ...)
    jump: Array  # (n, q) at the end of the last one [length]
    pulled: Array  # (n,) nodes at which the law pulled then

    def arrays(self, start: str) -> dict[str, Array]:
        """All of it, with names that start so."""
        own = {f"{start}history {name}": value for name, value in self.history.items()}
        return own | {f"{start}jump": self.jump, f"{start}pulled": self.pulled}

    @classmethod
    def read(cls, arrays: dict[str, Array], start: str) -> Kept | None:
        """What ``arrays`` gave, found among others; None where it is not there."""
        if f"{start}jump" not in arrays:
            return None
        first = f"{start}history "
        own = {key[len(first) :]: value for key, value in arrays.items() if key.startswith(first)}
        return cls(own, arrays[f"{start}jump"], arrays[f"{start}pulled"])


@dataclass(frozen=True, eq=False)
class ToldContact(Friction):
    """Unknowns: those without friction, and where the law slips tau as under friction, whose own
    coefficients are 0."""

    pressed: ClassVar[tuple[int, ...]] = (CLOSED,)

    law: Law
    nodes: LawNodes  # all n as drawn, with the law's history at the start, and what it has read
    gap_drawn: Array  # (n,) that does not count [length]
    neighbours: Array  # (n,) of each node, on the surface

    @staticmethod
    def told(sides: Any, law: Law, nodes: LawNodes, gap: Array) -> tuple[Any, ...]:
        """Of a law of one's own all that it knows at first: coefficients of friction, and the
        fields of this class.

        Args:
            sides: the surfaces.
            law: of one's own.
            nodes: of the moving side, with areas, and with what users give sampled there.
            gap: (n,) as drawn [length].

        Raises:
            ContactInputError: a law that ties along the surface, or leaves the gap as drawn out
                and gives no forces for it.
        """
        if not law.slips and law.components != "normal":
            raise ContactInputError(
                f"law={law!r} ties along the surface: at finite deformation laws of your own slip, "
                "or have components 'normal'"
            )
        if not (law.slips or law.gives):
            raise ContactInputError(
                f"law={law!r} has closes_gap=False: at finite deformation the gap as drawn counts "
                "where a law gives no normal forces"
            )
        n = len(nodes.x)
        zero, nothing = np.zeros(n), np.zeros((n, law.jumps(sides.gdim)))
        nodes = replace(nodes, force=nothing, jump=nothing, before=nothing, status=np.full(n, OPEN))
        nodes = replace(
            nodes, history=kept_by(law, "start", nodes), given=kept_by(law, "begin_step", nodes)
        )
        cells = sides.mover.cells
        return zero, zero, law, nodes, zero if law.closes_gap else gap, neighbours(cells, n)

    def reading(self, given: dict[str, Array]) -> ToldContact:
        return replace(self, nodes=replace(self.nodes, given=given))

    @property
    def overlaps(self) -> bool:
        """Whether surfaces may overlap under its forces."""
        return self.law.gives

    @property
    def size(self) -> int:
        return super().size - (0 if self.law.slips else self._vectors)

    @property
    def _vectors(self) -> int:
        """Number of coordinates of the moving side's nodes."""
        return int(self.sides.mover.x.size)

    def carried(self, q: Array, R: Array) -> Array:
        return super().carried(q, R) if self.law.slips else q

    @property
    def owner(self) -> Array:
        every = super().owner
        return every if self.law.slips else every[: super().size - self._vectors]

    def check_reach(self, held: Held, asked: Array) -> None:
        """Require that nodes where the law pulled in the last increment are among those asked (k,).

        Raises:
            ContactError: they lie far from the frame, or beyond its edge.
        """
        lost = self._kept(held).pulled.copy()
        lost[asked] = False
        if lost.any():
            far, where = self.sides.within, "do not face the obstacle now"
            if np.isfinite(far):
                where = (
                    f"lie farther than {far:g} facets from the other side now, or beyond its edge"
                )
            raise ContactError(
                f"the law {self.law!r} pulls at {int(lost.sum())} nodes that {where}. Take coarser "
                "facets there, or a law that ends before"
            )

    def _jump(self, place: Any, held: Held, at: Array) -> tuple[Array, Tangents | None]:
        """(k, q) jumps of nodes (k,), and the base of their components along the surface."""
        parts, tangents = [], None
        if self.law.slips:
            assert held.origin is not None
            tangents = self._tangents(place, at)
            sigma = self.way(place, held.origin)[0][at]
            slip = self.sign * tangents.components(sigma)
            parts.append(self._kept(held).jump[at][:, : slip.shape[1]] + slip)
        if self.law.gives:
            parts.append((self.gap_drawn - place.gap)[at][:, None])
        return np.concatenate(parts, axis=1), tangents

    def _tangents(self, place: Any, at: Array) -> Tangents:
        ends = at, self.neighbours[at]
        first = self.sides.first[0]
        x = self.sides.split(place.z)[0]
        return Tangents.of(x, ends, place.normal[at], self.turned(place, at), first)

    @property
    def sign(self) -> float:
        """Of forces and motions of the moving side against the frame, as those of side 0."""
        return 1.0 if self.sides.moving == 0 else -1.0

    def _kept(self, held: Held) -> Kept:
        jump = self.nodes.jump
        return held.kept or Kept(self.nodes.history, 0.0 * jump, np.zeros(len(jump), dtype=bool))

    def _told(
        self, place: Any, q: Array, status: Array, held: Held, at: Array
    ) -> tuple[LawNodes, Tangents | None]:
        """What the law is told of nodes (k,), with their jump as it is."""
        n, gdim = place.normal.shape
        kept = self._kept(held)
        jump, tangents = self._jump(place, held, at)
        force = [q[:n][at][:, None]] if self.law.gives else []
        if tangents is not None:
            force.insert(0, self.sign * tangents.components(tangential(q, n, gdim)[at]))
        sample = self.nodes.sample
        return LawNodes(
            self.nodes.x[at],
            place.areas[0][at],
            force=np.concatenate(force, axis=1),
            N=q[:n][at],
            jump=jump,
            before=kept.jump[at],
            c=np.full(len(at), held.scale),
            status=status[at],
            history={name: value[at] for name, value in kept.history.items()},
            sample=None if sample is None else lambda value: sample(value)[at],
            given={name: value[at] for name, value in self.nodes.given.items()},
        ), tangents

    def said(
        self, place: Any, q: Array, status: Array, held: Held, at: Array
    ) -> tuple[Linear, Tangents | None]:
        """The law about this iterate, at nodes (k,)."""
        nodes, tangents = self._told(place, q, status, held, at)
        jump = nodes.jump
        said = linear(self.law, nodes, jump)
        if self.law.opens and self.law.gives and (jump[:, -1] < 0.0).any():
            shut = jump.copy()
            shut[~said.holds, -1] = np.maximum(jump[~said.holds, -1], 0.0)
            said = linear(self.law, replace(nodes, jump=shut), jump)
        return said, tangents

    def keeps(self, place: Any, q: Array, status: Array, held: Held) -> Callable[[], Kept]:
        """What is kept if this is the end of the increment."""

        def ended() -> Kept:
            at, kept = np.flatnonzero(status != OPEN), self._kept(held)
            nodes = self._told(place, q, status, held, at)[0]
            kept_now = kept_by(self.law, "end_step", nodes)
            history = {name: value.copy() for name, value in kept.history.items()}
            for name, value in kept_now.items():
                every = np.zeros((len(kept.jump), *np.shape(value)[1:]), np.asarray(value).dtype)
                history.setdefault(name, every)[at] = value
            jump = kept.jump.copy()
            jump[at] = nodes.jump
            surface = self.sides.mover
            least = PULLS * held.scale * surface.facet_size
            return Kept(history, jump, q[: len(jump)] < -least)

        return ended


def neighbours(facets: Array, n: int) -> Array:
    """(n,) a node that shares an edge with each of n nodes, of facets (f, k)."""
    found = np.zeros(n, dtype=np.int64)
    found[facets] = np.roll(facets, -1, axis=1)
    return found
