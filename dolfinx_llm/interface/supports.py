"""What supports at surfaces mean for an interface: whether one moves as a whole, which rows had
better stay, which normals lie in planes of symmetry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.cells import unit, vector_areas
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.neighbours import STRAIGHT
from dolfinx_llm.geometry.overlap_curved import is_flat
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.site import Site, places

ACROSS = 1e-6  # direction cosine with the normal up to which a dof lies in the contact plane
FINER = 0.9  # distance of a tool's nodes over the other's, below which it is the finer one
NODES_ACROSS = 4  # nodes of the other side over a flat tool, in each direction
HELD_IN = 1e-2  # of a facet's size, by which supports may hold bodies in each other, as chords do
NEXT_TO = 1e-3  # the same of normals at planes of symmetry, as meshes tell them


def prescribed_side(site: Site, sides: Sequence[Surface]) -> int | None:
    """Of surfaces that may part the one whose motion supports prescribe at all nodes, as that of a
    rigid tool, if it is the finer one: with the frame on the other side its nodes would press
    between those of coarser facets, which have no motions to follow all of them. Where both are
    flat several facets of the other one must lie across the tool: those at its rim go on beyond it,
    which nodes of the tool tell better.

    Args:
        site: of the interface.
        sides: the surfaces, or what of them may touch.
    """
    law, design = site.interface.law, site.interface.design
    asked = site.interface.frame is not None or design in ("positions", "weights")
    if site.held is None or asked or not law.opens or law.gives:
        return None
    known = [
        bool(held[places(whole, side)].all())
        for held, whole, side in zip(site.held, site.whole, sides, strict=True)
    ]
    if known[0] == known[1]:
        return None
    k = known.index(True)
    tool, other = sides[k], sides[1 - k]
    if all(straight(side) for side in sides):
        few = NODES_ACROSS ** (tool.x.shape[1] - 1)
        if np.count_nonzero(_over(other, tool)) < few:
            return None
    return k if _spacing(tool) < FINER * _spacing(other) else None


def straight(side: Surface) -> bool:
    """Whether a surface lies in one plane."""
    return is_flat(side, STRAIGHT * side.diameter)


def _over(side: Surface, tool: Surface) -> Array:
    """(n,) corners of a side's facets that lie over a tool's facets, not beside them."""
    tool, side = tool.of_corners(), side.of_corners()
    return np.asarray(Frame(tool.x, tool.facets).locate(side.x).outside <= 0.0)


def _spacing(side: Surface) -> float:
    """About how far apart a surface's corners are [length]."""
    area = np.linalg.norm(vector_areas(side.x, side.facets), axis=1).sum()
    return float((area / len(np.unique(side.facets))) ** (1.0 / (side.x.shape[1] - 1)))


def in_supports_planes(
    site: Site, pairs: Sequence[ContactPairs], normals: Sequence[Array] | None = None
) -> list[ContactPairs]:
    """Pairs of curved surfaces whose normals lie in the planes that supports hold nodes on, where
    these mean planes of symmetry: what meshes make of normals there would bind a node across the
    plane by what is left of its motion, next to nothing.

    Args:
        site: of the interface.
        pairs: per side.
        normals: per side (n, gdim) by which planes of symmetry are told; None: those of the pairs.
    """
    if not site.held or site.interface.law.components != "local":
        return list(pairs)
    out, told = [], [p.normal for p in pairs] if normals is None else normals
    for held, p, normal in zip(_held_dofs(site, pairs), pairs, told, strict=True):
        flat = held & (np.abs(normal) < NEXT_TO)
        across, gap = (np.where(flat, 0.0, of) for of in (p.normal, p.gap))
        out.append(replace(p, normal=unit(across), gap=gap))
    return out


def _held_dofs(site: Site, pairs: Sequence[ContactPairs]) -> list[Array]:
    """Per side (n, components) prescribed dofs of pairs, of a site that knows them."""
    sides = zip(site.whole, site.held or (), pairs, strict=True)
    return [held[places(own, p.surface)][p.nodes] for own, held, p in sides]


def kept_nodes(site: Site, pairs: Sequence[ContactPairs]) -> list[Array] | None:
    """Per side (n,) pairs whose rows had better stay: Dirichlet conditions prescribe a motion that
    the law ties, or other interfaces have the node, too: round a joint where interfaces meet rows
    repeat each other exactly, or not at all. None: there are none."""
    normal_only = site.interface.law.components == "normal"
    held = _held_dofs(site, pairs) if site.held else []
    keep = []
    for i, (p, whole) in enumerate(zip(pairs, site.whole, strict=True)):
        # What is prescribed across the normal is free without friction.
        used = np.abs(p.normal) > ACROSS if normal_only else np.ones(p.normal.shape, dtype=bool)
        found = np.zeros(len(p.nodes), dtype=bool)
        if held:
            found |= (held[i] & used).any(axis=1)
        if site.shared:
            found |= site.shared[i][places(whole, p.surface)][p.nodes]
        keep.append(found)
    return keep if any(k.any() for k in keep) else None
