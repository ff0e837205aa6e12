"""What a solve gives of one side of an interface: forces, gaps, status of its nodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.interface.control import at_nodes
from dolfinx_llm.interface.density import density_at_nodes, with_coarser
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.laws.rows import CLOSED, OPEN

FELT = 1e-9  # part of the largest force or motion, below which there is none
FARTHER = 2.0  # times the most that bodies move along each other: no slip is beyond
FOREMOST = 0.5  # part of the largest force from which on a node carries what no other does
IDLE = 1e-13  # force over the surfaces' stiffness times their motion that is rounding


@dataclass(frozen=True, eq=False)
class SideResult:
    """One side of an interface; n nodes that may touch, sorted by position.

    A node is closed where it presses, or where the bodies touch without force; with friction it has
    the status of the node of the law next to it: the frame's, along curved surfaces its own, or
    that of the other side. Beside contact forces die out from node to node, down
    to 1e-9 of the largest, below which a node is open. ``slip`` is counted from the drawing, and to
    the frame, which moves as the mean of both bodies do: of a sliding interface it is half of the
    way that one body goes along the other. Against a rigid obstacle that takes the frame's place.
    """

    x: Array  # (n, gdim) node positions X [length]
    u: Array  # (n, gdim) their displacements [length]
    force: Array  # (n, gdim) forces that the body exerts on the frame [force]
    normal: Array  # (n, gdim) frame normal, out of this side
    normal_force: Array  # (n,) positive in compression [force]
    gap: Array  # (n,) distance to the other body along the normal, 0 where closed [length]
    # (n,) the same to the frame as the law has it; beside contact, where it hardly knows, any
    # number [length]
    frame_gap: Array
    slip: Array  # (n, gdim) tangential motion relative to the frame, 0 where open [length]
    status: Array  # (n,) 0 open, 1 stick, 2 slip, 3 closed without friction
    area: Array  # (n,) tributary area: the force of unit pressure [area]
    pressing: Array  # (n,) normal_force, of second order of its control values, see
    # ``operators.control``: these are not negative where bodies may part [force]
    facets: Array  # (m, c) first-order facets between these nodes, all of them
    density: Array | None = None  # (n, gdim) of the forces on the surface, see
    # ``interface.density``; None at first order, where the frame's are [force / area]

    @property
    def X(self) -> Array:
        """(n, gdim) as drawn: x [length]."""
        return self.x

    @property
    def drawn(self) -> Array:
        """(n, gdim) x [length]."""
        return self.x

    @property
    def tangential_force(self) -> Array:
        """(n, gdim) part of the force in the contact plane [force]."""
        return self.force - self.normal_force[:, None] * self.normal


def side_result(
    pairs: ContactPairs,
    multiplier: Array,
    u: Array,
    follows: Array,
    gap: Array,
    status: Array,
    presses: bool,
) -> SideResult:
    """One side's result from its multipliers (n, c), u and the motion of the point it touches
    (n, gdim), the initial gap that counts (n, gdim) and the status (n,); whether no pair pulls."""
    force = np.einsum("nc,nci->ni", multiplier, pairs.base)
    motion, across = u - follows, np.einsum("ni,ni->n", force, pairs.normal)
    normal_motion = np.einsum("ni,ni->n", motion, pairs.normal)
    return SideResult(
        x=pairs.X,
        u=u,
        force=force,
        normal=pairs.normal,
        normal_force=across,
        gap=np.zeros(len(force)),
        frame_gap=-normal_motion - np.einsum("ni,ni->n", gap, pairs.normal),
        slip=motion - normal_motion[:, None] * pairs.normal,
        status=status,
        area=pairs.forces,
        pressing=across,
        facets=pairs.skin,
        density=density_at_nodes(pairs, force, presses),
    )


def read_together(geometry: InterfaceGeometry, sides: list[SideResult]) -> list[SideResult]:
    """The sides, tied ones with what the coarser one says of the traction of both, unless it is a
    prescribed one, where the other's forces arrive."""
    tied = geometry.frame is not None and geometry.interface.law.ties
    if not tied or geometry.site.prescribed is not None:
        return sides
    told = with_coarser(geometry.pairs, [s.force for s in sides], [s.density for s in sides])
    return [replace(side, density=value) for side, value in zip(sides, told, strict=True)]


def less(
    sides: Sequence[SideResult], pairs: Sequence[ContactPairs], forces: Array
) -> list[SideResult]:
    """The sides without some forces (n c,) of their rows, if there are any."""
    if not forces.any():
        return list(sides)
    each = np.split(forces.reshape(-1, pairs[0].base.shape[1]), [len(pairs[0].nodes)])
    return [
        replace(s, force=s.force - np.einsum("nc,nci->ni", own, p.base))
        for s, p, own in zip(sides, pairs, each, strict=False)
    ]


def between_bodies(
    geometry: InterfaceGeometry, sides: list[SideResult], scale: float, held: Array
) -> list[SideResult]:
    """The sides with gaps between the bodies, and open where these are apart and none of the pairs
    held (n,), which may pull.

    A node may lie on the frame, which is free there, and the other body be away: what it carries
    is rounding then, of the surfaces' stiffness ``scale`` times their motion. Of second order also
    what dies out from node to node beside contact, as corrected rows of one side balance there:
    such a node is open where it presses by less than that stiffness makes of the gap, and is none
    of those that press most: curved facets touch in between.
    """
    gaps = [side.frame_gap for side in sides]
    force = max(np.abs(side.normal_force).max(initial=0.0) for side in sides)
    size = max(np.abs(a).max(initial=0.0) for side in sides for a in (side.u, side.frame_gap))
    nothing, law = IDLE * scale * size, geometry.interface.law
    least = max(FELT * force, nothing)
    presses = [(side.status != OPEN) & (side.normal_force > least) for side in sides]
    if law.gives or not np.concatenate(presses).all():  # where all press there are none
        both = zip(geometry.pairs, sides, strict=True)
        x = [s.x + (s.u if p.control is None else p.control @ s.u) for p, s in both]
        for k, N in enumerate(geometry.opposite):
            across = N @ x[1 - k] - x[k]
            along = np.einsum("ni,ni->n", across, sides[k].normal)
            beside = ~geometry.faced[k] & (along < 0.0)  # of nothing: the nearest point tells
            gaps[k] = np.where(beside, np.linalg.norm(across, axis=1), along)
    out, ends = [], np.cumsum([len(side.x) for side in sides])
    each = zip(geometry.pairs, sides, gaps, presses, np.split(held, ends[:-1]), strict=True)
    for p, side, gap, pressed, pulls in each:
        if p.control is not None and not law.gives:
            pressed = pressed & (side.normal_force > np.minimum(scale * gap, FOREMOST * force))
        closed = (side.status != OPEN) & (pressed | (gap <= FELT * size) | pulls)
        if not law.opens:
            closed[:] = True
        idle = ~closed & (np.linalg.norm(side.force, axis=1) <= nothing)
        out.append(
            replace(
                side,
                force=np.where(idle[:, None], 0.0, side.force),
                normal_force=np.where(idle, 0.0, side.normal_force),
                pressing=np.where(idle, 0.0, side.pressing),
                gap=gap if law.gives else np.where(closed, 0.0, np.maximum(gap, 0.0)),
                slip=np.where(closed[:, None], side.slip, 0.0),
                status=np.where(closed, side.status, OPEN),
            )
        )
    return out


def nodal_sides(geometry: InterfaceGeometry, sides: Sequence[SideResult]) -> tuple[SideResult, ...]:
    """The sides with values at nodes, where those of second-order bodies are control values."""
    found = []
    for p, side in zip(geometry.pairs, sides, strict=True):
        if p.control is not None:
            force = at_nodes(p, side.force)
            side = replace(
                side,
                u=p.control @ side.u,
                force=force,
                normal_force=np.einsum("ni,ni->n", force, side.normal),
                gap=p.control @ side.gap if geometry.rigid else side.gap,
                frame_gap=p.control @ side.frame_gap,
                slip=p.control @ side.slip,
                area=at_nodes(p, side.area),
            )
        found.append(side)
    return tuple(found)


def known_slips(
    geometry: InterfaceGeometry, sides: Sequence[SideResult], idle: Array
) -> tuple[SideResult, ...]:
    """The sides (of nodes) with slips where the frame tells none, half of the motion of the bodies
    along each other: along what supports hold on both sides, rows (n c,) that are left out; of
    pairs in contact that do not follow the frame, without friction of their own; and where it has
    gone farther than any of the bodies along each other, as nodes at the rim of contact may, of
    which pairs see small entries of corrected rows alone."""
    found, first, law = [], 0, geometry.interface.law
    other = zip(geometry.opposite, sides, sides[::-1])
    jumps = [side.u - N @ across.u for N, side, across in other]
    farthest = [_along_surface(jump, side) for jump, side in zip(jumps, sides)]
    most = FARTHER * max((far.max(initial=0.0) for far in farthest), default=0.0)
    for k, jump in enumerate(jumps):
        p, side = geometry.pairs[k], sides[k]
        untold = idle[first : first + p.base[:, :, 0].size].reshape(p.base.shape[:2]).copy()
        first += untold.size
        if not law.gives:
            untold |= (side.status == CLOSED)[:, None]
        untold |= (_along_surface(side.slip, side) > most)[:, None]
        untold[side.status == OPEN] = untold[:, -1] = False  # the last row is the normal's
        own = 0.5 * jump - side.slip
        along = np.einsum("nci,ni->nc", p.base, own) * untold
        found.append(replace(side, slip=side.slip + np.einsum("nc,nci->ni", along, p.base)))
    return tuple(found) or tuple(sides)


def _along_surface(motion: Array, side: SideResult) -> Array:
    """(n,) how far motions (n, gdim) go along a side where it is in contact [length]."""
    across = np.einsum("ni,ni->n", motion, side.normal)[:, None] * side.normal
    return np.linalg.norm(motion - across, axis=1) * (side.status != OPEN)
