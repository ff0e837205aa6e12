"""Sliding without opening: normals are tied, nothing acts along the surface."""

from __future__ import annotations

from dataclasses import dataclass

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.rows import LawNodes


@dataclass(frozen=True)
class Sliding(Law):
    """The bodies slide along each other and never part: a guide, a slip condition. Against a
    ``RigidPlane`` that is a support across any axis; normal forces may pull.

    >>> Sliding(), Sliding().opens, Sliding().jumps(3)
    (Sliding(), False, 2)
    """

    opens, slips, closes_gap = False, True, False

    def force(self, nodes: LawNodes) -> tuple[Array, Array]:
        """None along the surface; see ``Law``.

        Args:
            nodes: what is known at the last iterate.
        """
        return 0.0 * nodes.jump, 0.0 * nodes.jump
