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
from dolfinx_llm.interface.frames import choose_frame, move_nodes
from dolfinx_llm.interface.geometry import ContactModel
from dolfinx_llm.interface.join import Part, joined, whole_piece
from dolfinx_llm.interface.touching import check_flat, find_pieces

log = logging.getLogger("dolfinx_llm")

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
    owners = [_space_of(tags, spaces) for tags, _ in interface.tagged_sides()]
    whole = tuple(
        extract_surface(spaces[i], tags, tag)
        for i, (tags, tag) in zip(owners, interface.tagged_sides())
    )
    notes: list[str] = []
    if interface.obstacle is not None:
        pairs, rim = against_obstacle(interface.obstacle, whole[0], interface.name, notes)
        clock.stop("surfaces")
        base = np.empty((0, *pairs.base.shape[1:]))
        return _model(interface, owners, [pairs], None, base, None, [rim], notes, clock)
    check_sides(whole[0], whole[1], same_mesh=owners[0] == owners[1])
    clock.stop("surfaces")
    law = interface.law
    pieces, whole_rims = find_pieces(whole, law.unilateral, interface.name, notes)
    if len(pieces) > 1 and interface.frame is not None:
        pieces = [whole_piece(pieces)]
    clock.stop("facing facets")
    held: Any = None if fixed is None else [(spaces[i], fixed[i]) for i in owners]
    parts: list[Part] = []
    for piece in pieces:  # one frame has cells of one kind
        corners = parts[0].frame.cells.shape[1] if parts else None
        parts.append(_build_piece(interface, whole, piece, spaces[0], held, corners, notes, clock))
    both, frame, base, certificate = joined(whole, parts)
    rims = [
        rim[np.isin(side.dofs, p.surface.dofs)][p.nodes]
        for rim, side, p in zip(whole_rims, whole, both, strict=True)
    ]
    return _model(interface, owners, both, frame, base, certificate, rims, notes, clock)


def _build_piece(
    interface: Interface,
    whole: Sequence[Surface],
    piece: Piece,
    V: Any,
    held: Any,
    corners: int | None,
    notes: list[str],
    clock: Clock,
) -> Part:
    """Common area, frame, design and pairs of one piece of two surfaces.

    Args:
        corners: of a predicted frame's cells; None: those of the coarser side.
        held: per side its function space and (n_owned dofs,) whether a dof is prescribed.
    """
    law, plane = interface.law, piece.plane
    sides = whole[0].part(piece.facets[0]), whole[1].part(piece.facets[1])
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
    frame, note, reach = choose_frame(interface, sides, forces, plane, area, corners)
    notes.append(note)
    clock.stop("frame")
    if interface.design == "positions" and frame.gdim == 3:
        frame = move_nodes(frame, sides, forces, V.mesh.comm)
        notes.append("design: frame nodes moved (positions)")
        clock.stop("design")
    pairs = [
        locate_pairs(side, f, frame, sign, reach, plane)
        for side, f, sign in zip(sides, forces, (1.0, -1.0))
    ]
    clock.stop("location")
    if plane is None:
        pairs, certificate = _balanced(interface, frame, pairs, vectors, notes)
        base = local_bases(nodal_normals(frame))
    else:
        normal_only = law.unilateral and not law.friction
        keep = held and [
            _fixed_nodes(p, space, fixed, normal_only) for p, (space, fixed) in zip(pairs, held)
        ]
        pairs, certificate = _designed(interface, frame, plane, pairs, notes, keep)
        base = np.broadcast_to(plane.base, (len(frame.x), *plane.base.shape))
    clock.stop("design")
    return Part(tuple(pairs), frame, base, certificate)


def _model(
    interface: Interface,
    owners: Sequence[int],
    pairs: Sequence[ContactPairs],
    frame: Frame | None,
    base: np.ndarray,
    certificate: Certificate | None,
    rims: Sequence[np.ndarray],
    notes: Sequence[str],
    clock: Clock,
) -> ContactModel:
    """The model with the base vectors and frame directions that the law needs.

    Args:
        base: (m, gdim, gdim) tangents and normal, out of side 0, at the frame's nodes.
    """
    law, gdim = interface.law, base.shape[2]
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
        interface, tuple(p.surface for p in pairs), tuple(owners), tuple(pairs), frame, base,
        float(pairs[0].forces.sum()), certificate, tuple(rims), tuple(notes), clock.times,
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

    Args:
        vectors: pair of (n_surface, gdim) vector areas in contact [area].
    """
    close_gap = interface.law.unilateral or interface.law.close_gap
    vectors = [a[p.nodes] for a, p in zip(vectors, pairs, strict=True)]
    plain = [p.N for p in pairs]
    if interface.design is not None:
        pairs, stencils, P, groups = curved_rows(frame, pairs, close_gap)
        N = balance(frame, pairs, vectors, stencils, P, groups)
        pairs = [replace(p, N=M) for p, M in zip(pairs, N, strict=True)]
    N = [p.N for p in pairs]
    before, after = (np.linalg.norm(vector_residual(M, vectors), axis=1) for M in (plain, N))
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


def _fixed_nodes(pairs: ContactPairs, V: Any, fixed: np.ndarray, normal_only: bool) -> np.ndarray:
    """(n,) whether a Dirichlet condition prescribes a motion that the law ties, on all ranks.

    Args:
        fixed: (n_owned dofs,) whether a dof is prescribed.
        normal_only: the law ties the normal motion alone: what is prescribed across it is free.
    """
    mine = pairs.owner == V.mesh.comm.rank
    start = V.dofmap.index_map.local_range[0]
    held = np.zeros(len(mine), dtype=np.int64)
    used = np.abs(pairs.normal[mine]) > ACROSS if normal_only else True
    at = fixed.reshape(-1, pairs.x.shape[1])[pairs.dofs[mine] - start]
    held[mine] = (at & used).any(axis=1)
    return V.mesh.comm.allreduce(held) > 0


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
        try:  # rows at supports bind the frame's edge: better left alone, where that is enough
            N = design_weights(frame, s, plain, forces, keep)
        except ContactError:
            N = design_weights(frame, s, plain, forces)
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
