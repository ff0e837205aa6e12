"""What of curved surfaces that may part is near enough for rows of second order.

Tags go on where bodies curve away from each other, as the flanks of a roller do. Areas that face
each other differ there by more than small corrections of rows make up for, and what does not
balance reaches rows in contact. Parts that lie far apart are left out, as if the tags had been cut
by hand, and must stay open.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError
from dolfinx_llm.geometry.cells import cell_sizes, connected
from dolfinx_llm.geometry.facing import separation
from dolfinx_llm.geometry.pieces import Piece
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.carrier import residual_of
from dolfinx_llm.interface.join import Part
from dolfinx_llm.interface.site import Site

LEVELS = np.linspace(0.0, 1.0, 21)  # of distance, in parts of the facets that are left out
SHRINKS = 0.7  # distance from one try to the next
NEAR_ENOUGH = 0.05  # distance, in facets, below which surfaces are near
HARDLY_LEFT = 0.125  # patch residual up to which no nearer parts are looked for: about the angle
# between both surfaces where they are cut, which is less where they touch

Built = tuple[Site, list[Part], list[str]]


def balanced_parts(
    site: Site, pieces: Sequence[Piece], build: Callable[[Sequence[Piece]], Built]
) -> Built:
    """What is built of pieces that touch, or of the largest parts of second-order ones that rows
    balance.

    Args:
        site: of the interface.
        pieces: of both surfaces.
        build: of pieces.

    Raises:
        ContactError: nothing can be built, with what is said of the whole.
    """
    found, failed = None, None
    for near in _nearer(site, pieces):
        try:
            built = build(near)
        except ContactError as error:
            failed = failed or error
            continue
        built[2].extend(_left_out(site, pieces, near))
        # Where supports move a side as a whole they bear what does not balance.
        if built[0].prescribed is not None or residual_of(built[1]) <= HARDLY_LEFT:
            return built
        found = found or built
    if found is None:
        assert failed is not None
        raise failed
    return found


def _nearer(site: Site, pieces: Sequence[Piece]) -> Iterator[list[Piece]]:
    """The pieces that touch and, of second-order surfaces that may part along a curved one, its
    parts where both lie less and less far apart, if what is left out goes away from these."""
    yield [*pieces]
    sides, opens = site.whole, site.interface.law.opens
    second = all(side.element.order > 1 for side in sides)
    designs = site.interface.frame is None and site.interface.design is not None
    if not (opens and second and designs and pieces[0].plane is None):
        return
    (piece,) = pieces  # several have a plane each
    distance = [_distances(sides[k], sides[1 - k], piece.facets[k]) for k in (0, 1)]
    limit = SHRINKS * max(d.max() for d in distance)
    size = max(cell_sizes(s.x, s.facets[own]).mean() for s, own in zip(sides, piece.facets))
    while limit >= NEAR_ENOUGH * size and all((d <= limit).any() for d in distance):
        keep = [np.flatnonzero(d <= limit) for d in distance]
        near = piece.only(*keep)
        cut = [_at_cut(*of) for of in zip(sides, piece.facets, near.facets, strict=True)]
        if all(map(_only_beyond, sides, piece.facets, distance, near.facets, cut)):
            yield [replace(near, cut=(cut[0], cut[1]))]
        limit *= SHRINKS


def _left_out(site: Site, pieces: Sequence[Piece], near: Sequence[Piece]) -> list[str]:
    """What is said of facets that were left out."""
    if near[0].cut is None:
        return []
    return [
        f"{len(whole) - len(kept)} of {len(whole)} facets of {side.name} that face the other side "
        "left out: they lie too far from the other one for rows that balance, and must not touch"
        for side, whole, kept in zip(site.whole, pieces[0].facets, near[0].facets, strict=True)
        if len(kept) < len(whole)
    ]


def _distances(side: Surface, other: Surface, facets: Array) -> Array:
    """(k,) of some facets of a side from the other one [length]: across, so that nodes beyond its
    rim do not count where others of the facet lie over it."""
    apart, nodes = separation(side, other), side.facets[facets]
    over = apart.over[nodes]
    over[~over.any(axis=1)] = True
    return np.asarray((apart.distance[nodes] * over).sum(axis=1) / over.sum(axis=1))


def _at_cut(side: Surface, facets: Array, near: Array) -> Array:
    """(n,) nodes of a side that facets near to the other one share with those that are not."""
    both = np.ones(len(side.x), dtype=bool)
    for some in (near, np.setdiff1d(facets, near)):
        own = np.zeros(len(side.x), dtype=bool)
        own[side.cells[some]] = True
        both &= own
    return both


def _only_beyond(side: Surface, facets: Array, distance: Array, near: Array, cut: Array) -> bool:
    """Whether what is left out goes away from where it was cut (n,): what is nearer than some level
    hangs together with that. Else a crest might touch by itself, while nothing presses there."""
    left = ~np.isin(facets, near)
    own, away = side.cells[facets[left]], distance[left]
    at_cut = cut[own].any(axis=1)
    for level in np.quantile(away, LEVELS) if len(own) else ():
        below = away <= level
        label = connected(own[below], len(side.x))[0]
        if not np.isin(label, label[at_cut[below]]).all():
            return False
    return True
