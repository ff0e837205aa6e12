"""Which side a frame moves with: both alike, or one of them, that carries it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import identity
from scipy.spatial import cKDTree

from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.base.sparse import diagonal
from dolfinx_llm.design.predict import coarser_side
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.pairs import ContactPairs, rank_certificate, with_weights
from dolfinx_llm.geometry.pieces import Piece
from dolfinx_llm.interface.join import Part, whole_piece
from dolfinx_llm.interface.rows import COARSE
from dolfinx_llm.interface.site import Site
from dolfinx_llm.interface.supports import prescribed_side

OWN_PLACE = 1e-12  # distance of nodes over a surface's diameter, that is none


def with_carrier(site: Site, pieces: Sequence[Piece]) -> Site:
    """The same; with friction between surfaces some of which are curved, the one with fewer nodes
    carries the frame, and the law holds at the nodes of the other (``contact.friction_nodes``). One
    that supports move as a whole does, whatever its nodes, without friction as well.

    Args:
        site: with its law.
        pieces: of the surfaces that touch.
    """
    law = site.interface.law
    sides = whole_piece(pieces).parts(site.whole)
    site = replace(site, prescribed=prescribed_side(site, sides))
    if site.prescribed is not None:
        # Normals of second order need all of the frame's motion, which normal rows alone lack.
        curved = any(piece.plane is None for piece in pieces)
        full = law.slips or (curved and any(side.element.order > 1 for side in sides))
        return replace(site, carrier=site.prescribed if full else None)
    if law.gives or not (law.opens and law.slips):
        return site
    if all(piece.plane is not None for piece in pieces):
        return site
    # Nodes of second order between corners count, and do not follow a frame of first order.
    sizes = [(len(side.x), side.element.order) for side in sides]
    carrier = int(sizes[1] < sizes[0])
    if sizes[0] == sizes[1]:
        carrier = coarser_side(sides, [np.ones(n) for n, _ in sizes], by_nodes=True)
    return replace(site, carrier=carrier)


def with_other_carrier(site: Site, parts: Sequence[Part]) -> Site | None:
    """Where orders differ and a frame on the side with fewer nodes does not pass, a site on which
    the other carries it: a first-order side with few nodes less may have far finer facets."""
    orders = {side.element.order for side in site.whole}
    if site.carrier is None or site.interface.frame is not None or len(orders) < 2:
        return None
    return replace(site, carrier=1 - site.carrier) if residual_of(parts) > COARSE else None


def at_own_nodes(pairs: ContactPairs, frame: Frame) -> ContactPairs:
    """Pairs of the side whose facets the frame's cells are, with rows of its own nodes: where
    facets are bent, the closest point of a node between corners is found a little beside it."""
    away, node = cKDTree(frame.x).query(pairs.x)
    own = away <= OWN_PLACE * pairs.surface.diameter
    rows = diagonal(own) @ identity(len(frame.x), format="csr")[node] + diagonal(~own) @ pairs.N
    return with_weights(pairs, rows.tocsr(), frame)


def residual_of(parts: Sequence[Part]) -> float:
    """The largest patch residual."""
    return max(part.certificate.residual for part in parts)


def say_carrier(site: Site) -> list[str]:
    """A sentence that says it, if one side carries the frame."""
    if site.prescribed is not None:
        frame = site.whole[site.prescribed].name
        return [f"supports move {frame} as a whole: it carries the frame, as a rigid obstacle"]
    if site.carrier is None:
        return []
    mover, frame = (site.whole[k].name for k in (1 - site.carrier, site.carrier))
    return [f"curved, with friction: the law holds at the nodes of {mover}, {frame} carries "
            "the frame"]  # fmt: skip


def check_carried(site: Site, parts: Sequence[Part]) -> None:
    """Require that the side that carries a frame that was given holds it alone.

    Raises:
        ContactError: it does not.
    """
    carrier = site.carrier
    if carrier is None or site.interface.frame is None:
        return
    for part in parts:
        own = part.pairs[carrier].N
        try:
            rank_certificate(part.frame, [own, own[:0]])
        except ContactError as failed:
            raise ContactError(
                f"interface {site.interface.name}: along curved surfaces with friction the side "
                f"with fewer nodes, {site.whole[carrier].name}, carries the frame. There {failed}"
            ) from failed
