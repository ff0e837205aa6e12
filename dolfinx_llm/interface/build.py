"""All that follows from an interface's geometry: surfaces, common area, frame, design, pairs."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base import compat
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.timing import Clock
from dolfinx_llm.design.curved import balance, curved_rows, nodal_normals, vector_residual
from dolfinx_llm.design.line import check_closed_form
from dolfinx_llm.design.weights import TOLERANCE, design_weights, patch_residual
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.overlap_curved import vector_areas_in_contact
from dolfinx_llm.geometry.overlap_flat import (
    Plane,
    common_area,
    local_bases,
    nodal_forces,
)
from dolfinx_llm.geometry.pairs import ContactPairs, locate_pairs, rank_certificate, with_weights
from dolfinx_llm.geometry.pieces import Piece
from dolfinx_llm.geometry.surface import Surface, check_sides, extract_surface
from dolfinx_llm.interface.against import against_obstacle
from dolfinx_llm.interface.anatomy import describe
from dolfinx_llm.interface.certificate import Certificate
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.interface.frames import REACH, choose_frame, move_nodes
from dolfinx_llm.interface.geometry import ContactModel, Site
from dolfinx_llm.interface.join import Part, joined, whole_piece
from dolfinx_llm.interface.touching import check_flat, find_pieces

log = logging.getLogger("dolfinx_llm")

COARSE = 0.1  # vector residual of curved surfaces, from which on it is said
UNITY = 1e-9  # by which the sum of a row may differ from 1
ACROSS = 1e-6  # direction cosine with the normal up to which a dof lies in the contact plane


def build_model(
    interface: Interface, spaces: Sequence[Any], fixed: Sequence[np.ndarray] | None = None
) -> ContactModel:
    """Surfaces, common area, frame, design and pairs of an interface.

    Collective. Everything after the gathering of the surfaces is computed alike on all ranks.

    Args:
        interface: the user's choices.
        spaces: function spaces, one per mesh.
        fixed: per space (n_owned dofs,) whether a dof is prescribed; None: none is.

    Raises:
        ContactError, ContactInputError: see the functions called.
    """
    clock = Clock()
    site = find_site(interface, spaces, fixed)
    clock.stop("surfaces")
    return build(site, clock)


def find_site(
    interface: Interface, spaces: Sequence[Any], fixed: Sequence[np.ndarray] | None = None
) -> Site:
    """The surfaces of an interface and what is prescribed there, gathered on every rank.

    Args:
        interface, spaces, fixed: as of ``build_model``.

    Raises:
        ContactError, ContactInputError: tags without facets, surfaces that share nodes.
    """
    tagged = interface.tagged_sides()
    owners = tuple(_space_of(tags, spaces) for tags, _ in tagged)
    whole = tuple(
        extract_surface(spaces[i], tags, tag) for i, (tags, tag) in zip(owners, tagged, strict=True)
    )
    if len(whole) == 2:
        check_sides(whole[0], whole[1], same_mesh=owners[0] == owners[1])
    held = None
    if fixed is not None:
        held = tuple(_held(side, spaces[i], fixed[i]) for side, i in zip(whole, owners))
    return Site(interface, whole, owners, held, spaces[0].mesh.comm)


def _held(side: Surface, V: Any, fixed: np.ndarray) -> np.ndarray:
    """(n, gdim) whether a Dirichlet condition prescribes a node's dof, on all ranks.

    Args:
        fixed: (n_owned dofs,) whether a dof is prescribed.
    """
    mine = side.owner == V.mesh.comm.rank
    start = V.dofmap.index_map.local_range[0]
    held = np.zeros(side.x.shape, dtype=np.int64)
    held[mine] = fixed.reshape(-1, side.x.shape[1])[side.dofs[mine] - start]
    return V.mesh.comm.allreduce(held) > 0


def build(site: Site, clock: Clock | None = None) -> ContactModel:
    """Common area, frame, design and pairs of surfaces where they are now.

    Raises:
        ContactError, ContactInputError: see the functions called.
    """
    clock = clock or Clock()
    interface, whole = site.interface, site.whole
    notes: list[str] = []
    if interface.obstacle is not None:
        return build_against(site, notes, clock)
    pieces, rims = find_pieces(whole, interface.law.unilateral, interface.name, notes)
    if len(pieces) > 1 and interface.frame is not None:
        pieces = [whole_piece(pieces)]
    clock.stop("facing facets")
    parts: list[Part] = []
    for piece in pieces:  # one frame has cells of one kind
        corners = parts[0].frame.cells.shape[1] if parts else None
        parts.append(build_piece(site, piece, notes, clock, corners))
    return assembled(site, parts, rims, notes, clock)


def build_against(
    site: Site, notes: list[str], clock: Clock, nodes: np.ndarray | None = None
) -> ContactModel:
    """The model of a body against a rigid obstacle.

    Args:
        nodes: (n,) those that take part; None: those that face the obstacle.
    """
    obstacle, name = site.interface.obstacle, site.interface.name
    assert obstacle is not None
    pairs, rim = against_obstacle(obstacle, site.whole[0], name, notes, nodes)
    clock.stop("surfaces")
    return _model(site, [pairs], None, None, None, [rim], notes, clock, ())


def assembled(
    site: Site,
    parts: Sequence[Part],
    whole_rims: Sequence[np.ndarray],
    notes: Sequence[str],
    clock: Clock,
) -> ContactModel:
    """The model of an interface from what was built of its pieces.

    Args:
        whole_rims: per side (n,) nodes at a rim that is too steep.
    """
    pairs, frame, base, certificate = joined(site.whole, parts)
    rims = [
        rim[np.isin(side.dofs, p.surface.dofs)][p.nodes]
        for rim, side, p in zip(whole_rims, site.whole, pairs, strict=True)
    ]
    return _model(site, pairs, frame, base, certificate, rims, notes, clock, tuple(parts))


def build_piece(
    site: Site,
    piece: Piece,
    notes: list[str],
    clock: Clock,
    corners: int | None = None,
    last: Part | None = None,
) -> Part:
    """Common area, frame, design and pairs of one piece of two surfaces.

    Args:
        corners: of a predicted frame's cells; None: those of the coarser side.
        last: what was built of it before, whose frame, where it has moved to, and nodes stay.
    """
    interface, law, plane = site.interface, site.interface.law, piece.plane
    sides = piece.parts(site.whole)
    area: Any = None
    if plane is None:  # curved: vector areas, smooth rows, balance in least squares
        if interface.design == "positions":
            raise ContactInputError("design='positions' needs flat sides; use 'weights' or 'auto'")
        vectors = vector_areas_in_contact(sides[0], sides[1], law.unilateral)
        forces = [np.linalg.norm(a, axis=1) for a in vectors]
    else:
        if not law.unilateral:
            check_flat(sides, plane)
        area = common_area(sides[0], sides[1], plane)
        forces = [nodal_forces(side, plane.project(side.x), area) for side in sides]
    clock.stop("patch forces")
    if last is None:
        frame, note, reach = choose_frame(interface, sides, forces, plane, area, corners)
    else:
        frame, note, reach = last.frame, "frame: moved with the bodies", REACH
    notes.append(note)
    clock.stop("frame")
    if interface.design == "positions" and frame.gdim == 3 and last is None:
        frame = move_nodes(frame, sides, forces, site.comm)
        notes.append("design: frame nodes moved (positions)")
        clock.stop("design")
    nodes = [f > 0.0 for f in forces] if last is None else [_mask(p) for p in last.pairs]
    pairs = [
        locate_pairs(side, f, frame, sign, reach, plane, nodes=taking_part)
        for side, f, sign, taking_part in zip(sides, forces, (1.0, -1.0), nodes, strict=True)
    ]
    clock.stop("location")
    if plane is None:
        pairs, certificate = _balanced(interface, frame, pairs, vectors, notes)
        base = local_bases(nodal_normals(frame))
    else:
        normal_only = law.unilateral and not law.friction
        keep = site.held and [
            _fixed_nodes(p, side, held, normal_only)
            for p, side, held in zip(pairs, site.whole, site.held, strict=True)
        ]
        pairs, certificate = _designed(interface, frame, plane, pairs, notes, keep)
        base = np.broadcast_to(plane.base, (len(frame.x), *plane.base.shape))
    clock.stop("design")
    return Part(piece, tuple(pairs), frame, base, certificate)


def _mask(pairs: ContactPairs) -> np.ndarray:
    """(n_surface,) nodes of a surface that take part."""
    mask = np.zeros(len(pairs.surface.x), dtype=bool)
    mask[pairs.nodes] = True
    return mask


def _model(
    site: Site,
    pairs: Sequence[ContactPairs],
    frame: Frame | None,
    base: np.ndarray | None,
    certificate: Certificate | None,
    rims: Sequence[np.ndarray],
    notes: Sequence[str],
    clock: Clock,
    parts: tuple[Part, ...],
) -> ContactModel:
    """The model with the base vectors and frame directions that the law needs.

    Args:
        base: (m, gdim, gdim) tangents and normal, out of side 0, at the frame's nodes; None: there
            is no frame.
    """
    interface, law, gdim = site.interface, site.interface.law, site.whole[0].x.shape[1]
    base = np.empty((0, gdim, gdim)) if base is None else base
    if law.unilateral:  # normals alone without friction
        first = 0 if law.friction else gdim - 1
        signs = (1.0, -1.0)
        pairs = [
            replace(p, base=(sign * local_bases(sign * p.normal))[:, first:])
            for p, sign in zip(pairs, signs)
        ]
        base = base[:, first:]
    else:
        base = np.broadcast_to(np.eye(gdim), base.shape)
    model = ContactModel(
        interface, tuple(p.surface for p in pairs), site.spaces, tuple(pairs), frame, base,
        float(pairs[0].forces.sum()), certificate, tuple(rims), tuple(notes), clock.times,
        site, parts,
    )  # fmt: skip
    if log.isEnabledFor(logging.INFO):
        stages = ", ".join(f"{stage} {seconds:.3g} s" for stage, seconds in clock.times.items())
        log.info("%s\n    %s", "\n".join(describe(model)).strip(), stages)
    return model


def _balanced(
    interface: Interface,
    frame: Frame,
    pairs: list[ContactPairs],
    vectors: Sequence[np.ndarray],
    notes: list[str],
) -> tuple[list[ContactPairs], Certificate]:
    """Pairs of curved surfaces after design, and their certificate.

    A design is taken only where it keeps rigid translations and, for bodies tied as drawn, lowers
    the vector residual that is printed, in its largest value and in its norm.

    Args:
        vectors: pair of (n_surface, gdim) vector areas in contact [area].
    """
    close_gap = interface.law.unilateral or interface.law.close_gap
    vectors = [a[p.nodes] for a, p in zip(vectors, pairs, strict=True)]
    plain = [p.N for p in pairs]
    before = np.linalg.norm(vector_residual(plain, vectors), axis=1)
    after = before
    if interface.design is not None:
        smooth, stencils, P, groups = curved_rows(frame, pairs, close_gap)
        N = balance(frame, smooth, vectors, stencils, P, groups)
        after = np.linalg.norm(vector_residual(N, vectors), axis=1)
        unity = max(float(np.abs(M.sum(axis=1) - 1.0).max()) for M in N)
        lower = after.max() < before.max() and np.linalg.norm(after) < np.linalg.norm(before)
        # Where the gap is closed, plain rows would close the chords' gaps, too.
        if (lower or close_gap) and unity <= UNITY:
            pairs = [replace(p, N=M) for p, M in zip(smooth, N, strict=True)]
        else:
            notes.append(
                f"design: left out, it would leave a patch residual of {after.max():.1e} (without "
                f"{before.max():.1e}) and rows that sum to 1 within {unity:.1e}; refine the meshes "
                "of the curved surfaces"
            )
            after = before
    N = [p.N for p in pairs]
    size = max(p.surface.diameter for p in pairs)
    certificate = Certificate(
        float(after.max()),
        float(before.max()),
        rank_certificate(frame, N),
        float(max(np.abs(p.x - M @ frame.x).max() for p, M in zip(pairs, N, strict=True)) / size),
        float(max(np.abs(a - b).max() for a, b in zip(N, plain, strict=True))),
    )
    notes.append(
        f"curved: vector areas, in least squares; root mean square of the patch residual "
        f"{np.sqrt(np.mean(after**2)):.1e} (before design {np.sqrt(np.mean(before**2)):.1e})"
    )
    if after.max() > COARSE:
        text = (
            f"curved surfaces are coarse: patch residual {after.max():.2g} of the largest nodal "
            f"area, above {COARSE:g}; stresses next to the interface are off by about as much. "
            "Refine both meshes along it"
        )
        log.warning("interface %s: %s", interface.name, text)
        notes.append(text)
    gap = max(np.abs(np.einsum("ni,ni->n", p.gap, p.normal)).max() for p in pairs)
    closed = "is closed" if close_gap else "is kept, tied as drawn without stress"
    if not interface.law.unilateral:
        notes.append(f"initial gap or overlap up to {gap:.3g} {closed}")
    return pairs, certificate


def _space_of(tags: Any, spaces: Sequence[Any]) -> int:
    """Index of the function space whose mesh the tags mark."""
    if len(spaces) == 1:
        return 0
    for i, V in enumerate(spaces):
        if compat.tags_belong_to(tags, V.mesh):
            return i
    raise ContactInputError(
        "the facet tags belong to none of the meshes of the forms. For bodies on two meshes give "
        "sides=((tags_0, tag_0), (tags_1, tag_1))"
    )


def _fixed_nodes(
    pairs: ContactPairs, whole: Surface, held: np.ndarray, normal_only: bool
) -> np.ndarray:
    """(n,) whether a Dirichlet condition prescribes a motion that the law ties.

    Args:
        whole: the surface as tagged.
        held: (n_whole, gdim) whether its nodes' dofs are prescribed.
        normal_only: the law ties the normal motion alone: what is prescribed across it is free.
    """
    used = np.abs(pairs.normal) > ACROSS if normal_only else True
    at = held[np.isin(whole.dofs, pairs.surface.dofs)][pairs.nodes]
    return (at & used).any(axis=1)


def _designed(
    interface: Interface,
    frame: Frame,
    plane: Plane,
    pairs: list[ContactPairs],
    notes: list[str],
    keep: Sequence[np.ndarray] | None,
) -> tuple[list[ContactPairs], Certificate]:
    """Pairs after design by weights where it is asked for or needed, and their certificate."""
    forces = [p.forces for p in pairs]
    plain = [p.N for p in pairs]
    before = float(np.abs(patch_residual(plain, forces)).max())
    N: Sequence[csr_matrix] = plain
    if interface.design == "weights" or (interface.design == "auto" and before > TOLERANCE):
        s = plane.project(frame.x)
        cells = [p.cell for p in pairs]
        try:  # rows at supports bind the frame's edge: better left alone, where that is enough
            N = design_weights(frame, s, plain, cells, forces, keep)
        except ContactError:
            N = design_weights(frame, s, plain, cells, forces)
        pairs = [with_weights(p, M, frame) for p, M in zip(pairs, N)]
        notes.append("design: rows of L_b corrected (weights)")
    elif interface.design == "auto":
        notes.append("design: left out, the frame passes as it is")
    elif interface.design is None:
        notes.append(f"design: none, as asked; patch residual {before:.1e}")
    residual = float(np.abs(patch_residual(N, forces)).max())
    if interface.design == "positions" and frame.gdim == 2:
        check_closed_form(residual, pairs, frame)
    singular = rank_certificate(frame, N)
    size = max(p.surface.diameter for p in pairs)
    linear = max(np.abs(plane.project(p.x) - plane.project(p.x - p.gap)).max() for p in pairs)
    change = 0.0 if N is plain else max(np.abs(a - b).max() for a, b in zip(N, plain))
    return pairs, Certificate(residual, before, singular, float(linear / size), float(change))
