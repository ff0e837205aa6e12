"""The base of contact laws: flags, and what a law is asked for. Plain NumPy."""

from __future__ import annotations

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError
from dolfinx_llm.laws.answers import at_nodes, spring_of
from dolfinx_llm.laws.rows import LawNodes, LawRows


class Law:
    """A contact law: base of those of the package and of your own.

    A law of your own says by flags which unknowns and conditions it needs, and gives ``force``: the
    forces for jumps of the surfaces, and their derivative. One that is better written the other way
    round, jumps for forces, or in parts (stick and slip), gives ``rows`` instead. What it has to
    remember stands in ``history``: arrays of an entry per node, made by ``start`` and brought on by
    ``end_step``; what users may change between load steps in ``given``, of ``begin_step``. The
    iteration is Newton's; forces should grow with jumps, or fall more slowly than the bodies'
    stiffness.

    Attributes:
        components: of the multipliers: "local", tangents and normal, "normal", or "cartesian".
        opens: pairs may part: λ_n >= 0, gap >= 0, λ_n gap = 0, but where ``LawRows.holds``.
        slips: forces along the surface follow the law, not a tie; with components "local".
        gives: so do normal forces: the surfaces may overlap, and part where pairs are held.
        closes_gap: the gap as drawn counts, where bodies may part along the normal.
        scalar: for scalar function spaces: jumps are those of a temperature, forces what flows;
            with components "cartesian", ``gives``, and neither ``opens`` nor ``slips``.
        shares: nodes that hardly any pair holds slip as a neighbour does (Coulomb's law, which asks
            for the sense of the slip); where the law opens and does not give.
        follows: pairs follow the frame and its jumps along the surface also where they are open, of
            laws that slip and do not share: nothing may act along it at the frame's nodes.

    >>> class Layer(Law):
    ...     components, gives = "normal", True
    ...     def force(self, nodes):
    ...         return 3.0 * nodes.area[:, None] * nodes.jump, 3.0 * nodes.area[:, None]
    >>> Layer(), Layer().jumps(3), Layer().ties
    (Layer(), 1, False)
    """

    components: str = "local"
    opens: bool = True
    slips: bool = False
    gives: bool = False
    closes_gap: bool = True
    scalar: bool = False
    shares: bool = False
    follows: bool = False

    def __init__(self) -> None:
        """Without arguments; dataclasses make their own."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}()"

    @property
    def ties(self) -> bool:
        """Whether bodies are one along the interface: nothing to iterate on."""
        return not (self.opens or self.slips or self.gives)

    @property
    def given_gap(self) -> float:
        """Gap that ties have beside the one drawn [length]."""
        return 0.0

    def jumps(self, gdim: int) -> int:
        """Number q of components of the jump.

        Args:
            gdim: dimensions of space.
        """
        return (gdim - 1) * self.slips + self.gives

    def components_of_jumps(self, c: int) -> slice:
        """Which base vectors have jumps.

        Args:
            c: their number: tangents and normal, or the normal alone.
        """
        return slice(0 if self.slips else c - 1, c if self.gives else c - 1)

    def check(self) -> None:
        """Require flags that go together.

        Raises:
            ContactInputError: they do not.
        """
        bases = ("local", "normal", "cartesian")
        fits = {"local": True, "normal": self.opens and not self.slips, "cartesian": self.ties}
        if self.scalar:
            only = self.gives and not (self.opens or self.slips)
            fits = {"cartesian": only}
        if not fits.get(self.components, False):
            raise ContactInputError(
                f"law {checks.shown(self)}: components={self.components!r} with "
                f"opens={self.opens}, slips={self.slips}, gives={self.gives}, "
                f"scalar={self.scalar}: give one of {bases}; 'normal' where the law opens and does "
                "not slip, 'cartesian' where it does none of the three, or is scalar and gives"
            )

    def start(self, nodes: LawNodes) -> dict[str, Array]:
        """What the law keeps, as drawn: arrays (k, ...); nothing by default.

        Args:
            nodes: at rest.
        """
        return {}

    def begin_step(self, nodes: LawNodes) -> dict[str, Array]:
        """What users give and may change between load steps, read anew at the start of each: arrays
        (k, ...), told as ``nodes.given``, which are no history; nothing by default.

        Args:
            nodes: their positions and areas, as drawn, and ``values`` of what users give; of forces
                and jumps nothing.
        """
        return {}

    def force(self, nodes: LawNodes) -> tuple[Array, Array]:
        """Forces (k, q) for jumps (k, q), and their derivative (k, q, q), or (k, q) of each
        component by its own jump.

        Args:
            nodes: what is known at the last iterate.

        Raises:
            NotImplementedError: a law of its own gives neither this nor ``rows``.
        """
        raise NotImplementedError(f"{type(self).__name__} gives neither force nor rows")

    def rows(self, nodes: LawNodes) -> LawRows:
        """The law linearised about the last iterate; by default that of ``force``.

        Args:
            nodes: what is known there.
        """
        return LawRows.springs(nodes, *spring_of(self, nodes))

    def miss(self, nodes: LawNodes) -> Array:
        """(k,) distance from the law [force]; by default what ``rows`` leave.

        Args:
            nodes: what is known at the last iterate.
        """
        return np.linalg.norm(self.rows(nodes).left(nodes), axis=1)

    def end_step(self, nodes: LawNodes) -> dict[str, Array]:
        """What the law keeps from this load step on; by default the same as before.

        Args:
            nodes: at the end of the step.
        """
        return nodes.history

    def strength(self, nodes: LawNodes) -> Array:
        """(k,) what each node bears [force]; nodes for which one speaks share its force by that.

        Args:
            nodes: what is known at the last iterate.
        """
        return nodes.N

    def at_stake(self, nodes: LawNodes) -> Array:
        """(k,) by how much another status would be felt [force]: where by hardly any, it does not
        matter which.

        Args:
            nodes: what is known at the last iterate.
        """
        size = np.abs(nodes.sums(at_nodes(self, "strength", nodes)))
        return np.maximum(np.linalg.norm(nodes.force, axis=1), size)
