"""An interface ready for assembly: the outcome of ``build``."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_matrix, identity

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.sparse import diagonal, pushed
from dolfinx_llm.design.curved import nodal_normals
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.interface.join import Certificate, Part
from dolfinx_llm.interface.obstacle import Swings
from dolfinx_llm.interface.obstacles import MeanDisplacement
from dolfinx_llm.interface.site import Site

OFF_RIM = 0.1  # of a facet, and of its distance, by which a node may lie beside a surface


@dataclass(frozen=True, eq=False)
class InterfaceGeometry:
    """An interface, ready for assembly; the same on every rank."""

    interface: Interface  # the user's choices
    sides: tuple[Surface, ...]  # two; one against a rigid obstacle
    spaces: tuple[int, ...]  # index of the function space of each side
    pairs: tuple[ContactPairs, ...]  # of each side
    frame: Frame | None  # None against a rigid obstacle
    # (m, d, gdim) in which the frame's nodes move, or an obstacle under prescribed forces (m = 1;
    # about a mean n - 1)
    directions: Array
    area: float  # of contact, for laws that let bodies part the area where they may touch [area]
    certificate: Certificate | None  # None against a rigid obstacle
    rims: tuple[Array, ...]  # per side (n,) pairs next to facets that were left out
    notes: tuple[str, ...]  # what was chosen or left out, and why
    times: dict[str, float]  # seconds per stage
    site: Site  # what it was built of
    parts: tuple[Part, ...]  # its pieces, one after the other in frame and pairs; none against an
    # obstacle
    forced: tuple[bool, ...] = ()  # per component whether a force on the obstacle is prescribed,
    # and a moment
    swings: Swings | None = None  # how a rigid end turns with the unknowns of ``directions``

    @property
    def rigid(self) -> bool:
        """Whether an obstacle takes the frame's place: it moves as a whole, or as prescribed."""
        return self.frame is None

    @property
    def curved(self) -> bool:
        """Whether a piece of the frame is."""
        return any(part.piece.plane is None for part in self.parts)

    @property
    def bent(self) -> bool:
        """Whether surfaces are curved, of second order at least one of them."""
        return self.curved and any(side.element.order > 1 for side in self.sides)

    @property
    def normals_alone(self) -> bool:
        """Whether the frame's nodes move along their normals only."""
        return self.frame is not None and self.interface.law.components == "normal"

    @property
    def places(self) -> Array:
        """(m, gdim) where the unknowns of ``directions`` are: the frame's nodes; of an obstacle
        under force the middle of what may touch it, about a mean the surface's but for one."""
        if self.frame is not None:
            return self.frame.x
        pairs = self.pairs[0]
        if self.interface.obstacle is not None and self.interface.obstacle.everywhere:
            return pairs.x[self.about_mean]
        return pairs.x.mean(axis=0)[None][: len(self.directions)]

    @property
    def about_mean(self) -> Array:
        """(m,) pairs whose motions about a mean the unknowns of ``directions`` are."""
        return np.asarray(self.pairs[0].N.argmax(axis=0)).ravel()

    def rotation(self, w: Array) -> Array | None:
        """(1,), (3,) of an obstacle [rad]; None of a frame.

        Args:
            w: (m d,) unknowns of ``directions``.
        """
        obstacle = self.interface.obstacle
        if obstacle is None:
            return None
        turn = np.array(obstacle.pose(self.sides[0].x.shape[1])[1])
        return turn if self.swings is None else turn + self.swings.rotation(w)

    @property
    def law_side(self) -> int | None:
        """The side at whose pairs the law holds: the one against a rigid obstacle, or the one that
        does not carry the frame; None: it holds at the frame's nodes."""
        if self.frame is None:
            return 0
        return None if self.site.carrier is None else 1 - self.site.carrier

    @cached_property
    def carries(self) -> Array:
        """(n,) pairs of the side that carries the frame, if there is one."""
        return self._pairs_of(self.site.carrier)

    @cached_property
    def prescribed(self) -> Array:
        """(n,) pairs of a side whose motion is prescribed, on which the frame lies."""
        return self._pairs_of(self.site.prescribed)

    def _pairs_of(self, side: int | None) -> Array:
        return np.concatenate([np.full(len(p.nodes), i == side) for i, p in enumerate(self.pairs)])

    @property
    def theta(self) -> float:
        """Part of the jump between the bodies that the unknowns κ are: 1 where a side jumps from
        what it meets, 1/2 where both do from the frame, (13)."""
        return 0.5 if self.law_side is None else 1.0

    @cached_property
    def law_nodes(self) -> tuple[Array, Array]:
        """Positions (k, gdim) and tributary areas (k,) of the nodes at which the law holds: the
        pairs of ``law_side``, or the frame's. There areas are the mean of both sides', which agree
        where surfaces are flat: neither is preferred."""
        if self.law_side is not None:
            pairs = self.pairs[self.law_side]
            return pairs.x, pairs.forces
        assert self.frame is not None
        x = self.frame.x
        areas = [pushed(N, p.forces) for N, p in zip(self.law_shapes, self.pairs, strict=True)]
        return x, np.mean(areas, axis=0)

    @cached_property
    def law_shapes(self) -> tuple[csr_matrix, ...]:
        """Per side (n, k) shape functions of these nodes at the pairs."""
        side = self.law_side
        if side is None:
            return tuple(pairs.N for pairs in self.pairs)
        k = len(self.pairs[side].nodes)
        own = identity(k, format="csr")
        sizes = [len(pairs.nodes) for pairs in self.pairs]
        return tuple(own if i == side else csr_matrix((n, k)) for i, n in enumerate(sizes))

    @property
    def normals(self) -> Array:
        """(m, gdim) at the frame's nodes; ones (m, 1) of a scalar field."""
        if self.frame is None or self.site.scalar or self.interface.law.components != "cartesian":
            return self.directions[:, -1]
        return nodal_normals(self.frame)

    @property
    def law_directions(self) -> Array:
        """(k, d, gdim) local base at these nodes, the normal last."""
        if self.law_side is None:
            return self.directions
        return (1.0, -1.0)[self.law_side] * self.pairs[self.law_side].base

    @property
    def jump_directions(self) -> Array:
        """(k, q, gdim) directions of jumps at these nodes."""
        directions = self.law_directions
        return directions[:, self.interface.law.components_of_jumps(directions.shape[1])]

    @cached_property
    def shares(self) -> csr_matrix:
        """(k, m) part that the frame's nodes have in those of the side that does not carry it: the
        positive entries of their rows, over their sum."""
        assert self.law_side is not None
        N = self.pairs[self.law_side].N.maximum(0.0)
        return diagonal(1.0 / np.asarray(N.sum(axis=1)).ravel()) @ N

    def at_law_nodes(self, x: Array) -> csr_matrix:
        """(j, k) values of the law's nodes at positions.

        Args:
            x: (j, gdim) as drawn [length].
        """
        if self.law_side is not None:
            return self.pairs[self.law_side].interpolation(x)
        assert self.frame is not None
        return self.frame.interpolation(self.frame.locate(x))

    @cached_property
    def opposite(self) -> tuple[csr_matrix, ...]:
        """Per side (n, n_other) values of the other side's nodes at the point of its facets, as
        drawn, that is closest to each node; empty against a rigid obstacle."""
        others = self.pairs[::-1] if len(self.pairs) == 2 else ()
        return tuple(q.interpolation(p.x) for p, q in zip(self.pairs, others))

    @cached_property
    def faced(self) -> tuple[Array, ...]:
        """Per side (n,) nodes that lie over the other side, and not beside it, as drawn."""
        found = []
        for k, N in enumerate(self.opposite):
            p = self.pairs[k]
            across, size = N @ self.pairs[1 - k].x - p.x, np.ptp(p.x[p.cells], axis=1).max()
            away = np.abs(np.einsum("ni,ni->n", across, p.base[:, -1]))
            beside = np.sqrt(np.maximum((across**2).sum(axis=1) - away**2, 0.0))
            found.append(beside <= OFF_RIM * (away + size))
        return tuple(found)


def describe(geometry: InterfaceGeometry) -> list[str]:
    """Lines for ``print(problem)``: what an interface consists of, what it leaves out and why."""
    law, nodes = geometry.interface.law, " + ".join(str(len(p.nodes)) for p in geometry.pairs)
    kind = "that may touch" if law.opens else "in contact"
    frame = "no frame" if geometry.frame is None else f"frame of {len(geometry.frame.x)} nodes"
    lines = [
        f"  interface {geometry.interface.name}, {law}: {nodes} nodes {kind}, {frame}, "
        f"area {geometry.area:.9g}"
    ]
    if geometry.frame is not None and geometry.certificate is not None:
        c, q = geometry.certificate, geometry.frame.quality
        lines += [
            f"    patch residual {c.residual:.1e} (before design {c.residual_before:.1e}), "
            f"singular values of L_b {c.singular_values[0]:.3g} to "
            f"{c.singular_values[1]:.3g}, linear fields to {c.linear:.1e}",
            f"    frame: angles {q.min_angle:.1f}° to {q.max_angle:.1f}°, shortest side "
            f"{q.min_side:.3g}",
        ]
    lines += [f"    {note}" for note in geometry.notes]
    if any(geometry.forced):
        lines.append(
            f"    the obstacle moves in {geometry.directions.shape[1]} way(s) under a force"
        )
    out = []
    if geometry.frame is None:
        mean = isinstance(geometry.interface.obstacle, MeanDisplacement)
        why = "prescribed mean" if mean else "rigid obstacle"
        out.append(f"frame, second side and proximal term ({why})")
    if law.ties:
        out.append("active set and local bases (tied)")
    elif law.components == "normal":
        out.append("tangential multipliers, tangential frame unknowns and slip (no friction)")
    return lines + [f"    left out: {text}" for text in out]
