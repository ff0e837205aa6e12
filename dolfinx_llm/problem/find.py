"""Interfaces found by themselves: all pairs of bodies whose surfaces touch, or lie near."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from dolfinx import mesh as dolfinx_mesh

from dolfinx_llm.base import checks, compat
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.base.parallel import agree, check, collective, gather_rows
from dolfinx_llm.geometry.facets_near import Polygons, facing_pairs
from dolfinx_llm.geometry.neighbours import faces
from dolfinx_llm.geometry.spaces import check_space
from dolfinx_llm.geometry.surface import Surface, check_facet_tags, extract_surface, facet_nodes
from dolfinx_llm.interface.choices import Interface
from dolfinx_llm.laws.law import Law
from dolfinx_llm.laws.tied import Tied
from dolfinx_llm.operators.bodies import Bodies

ANGLE = 0.5  # [rad] default of ``angle``
SPACES = "give a function space, or a list of those of several meshes"
SEVERAL_APART = "check positions and units, or give a larger distance"
ALL_JOINED = (
    "bodies must not share any node (in gmsh: do not fragment them; the Crack plugin leaves them "
    "joined at the rim unless that is its OpenBoundaryPhysicalGroup)"
)
LAWS = "give a dict of laws by pairs of cell tags, e.g. {(1, 2): Tied(), (2, 3): Coulomb(0.3)}"


@dataclass(frozen=True, eq=False)
class _Found:
    """The outsides of the bodies of one mesh, the same on every rank but for ``local``."""

    mesh: Any
    surface: Surface
    body: Array  # (m,) of each facet
    local: Array  # (l,) this rank's facets
    number: Array  # (l,) which facets of the surface these are
    tags: dict[int, Array] = field(default_factory=dict)  # cell tags of each body


def find_interfaces(
    facet_tags: Any,
    V: Any,
    law: Law | None = None,
    laws: Mapping[tuple[int, int], Law] | None = None,
    distance: float | None = None,
    angle: float | None = None,
    cell_tags: Any = None,
) -> list[Interface]:
    """Interfaces between all bodies whose surfaces touch or lie near; collective.

    Bodies are the parts of the meshes that hang together. Two facets of different bodies belong to
    an interface where their normals are opposite within ``angle``, one lies in front of the other,
    their distance there is at most ``distance``, and no other facet lies between them, as of a thin
    plate. A body may touch any number of others, with the same facets as well.

    Args:
        facet_tags: facets that are looked at, of any value: dolfinx mesh tags, or one or None for
            each space; None: all at the outside of the bodies.
        V: function space of the bodies, or a list of those of several meshes.
        law: of the interfaces that ``laws`` does not name; None: ``Tied()``, or where ``laws`` is
            given none: these pairs are left out.
        laws: law by pair of values of ``cell_tags``, in any order, as {(1, 2): Coulomb(0.3)}: of
            all bodies with the one value that touch any with the other.
        distance: largest distance of what may touch [length]; None: a tenth of the facets' size.
        angle: by which normals of what may touch are not opposite [rad]; None: 0.5.
        cell_tags: dolfinx mesh tags of cells, or one for each space: each body has one value.

    Returns:
        One ``Interface`` per pair of bodies, in the order of their numbers, or several where sharp
        edges part what faces, as around a key; of another law by
        ``dataclasses.replace(interface, law=...)``. The sides' tags are
        these numbers, as in ``print(problem)`` and messages, so that the name is "3 | 7".

    Raises:
        ContactInputError: arguments that do not fit.
        ContactError: no two bodies lie near each other.
    """
    spaces = list(V) if isinstance(V, (list, tuple)) else [V]
    if not spaces:
        checks.refuse("V", V, SPACES)
    for space in spaces:
        check_space(space, highest=2, scalar=True)
    comm = spaces[0].mesh.comm
    with collective(comm):
        by_facets = _per_space("facet_tags", facet_tags, spaces)
        by_cells = _per_space("cell_tags", cell_tags, spaces)
        chosen = _laws(law, laws, cell_tags)
        near, turn = _reach(distance, angle)
    told = [(key, checks.shown(value)) for key, value in chosen.items()]
    agree(comm, "laws, distance and angle", (told, near, turn))
    bodies = Bodies(spaces)
    found, first = [], 0
    for space, own, cells in zip(spaces, by_facets, by_cells, strict=True):
        n = space.dofmap.index_map.size_local
        found.append(_outside(space, own, cells, bodies.label[first : first + n]))
        first += n
    _check_keys(chosen, found)
    polygons = [Polygons.of(f.surface) for f in found]
    i, j = facing_pairs(polygons, _ids(found), near, turn, seen=True)
    if not len(i):
        what = "a tenth of their facets' size" if near is None else f"{near:g}"
        raise ContactError(
            f"no two of the {bodies.count} bodies have facets that face each other within {what}: "
            + (SEVERAL_APART if bodies.count > 1 else ALL_JOINED)
        )
    return _interfaces(found, i, j, chosen)


def _per_space(name: str, tags: Any, spaces: Sequence[Any]) -> list[Any]:
    """Mesh tags of each space; None where there are none."""
    if tags is None:
        return [None] * len(spaces)
    given = list(tags) if isinstance(tags, (list, tuple)) else [tags]
    if len(given) != len(spaces):
        checks.refuse(name, tags, f"give one for each of the {len(spaces)} function space(s)")
    for own, space in zip(given, spaces, strict=True):
        if own is None and name == "facet_tags":
            continue
        check_facet_tags(name, own)
        if not compat.tags_belong_to(own, space.mesh):
            raise ContactInputError(f"{name}: they belong to another mesh than the function space")
        dim = space.mesh.topology.dim - (name == "facet_tags")
        if own.dim != dim:
            raise ContactInputError(f"{name} of dimension {own.dim}: they must have {dim}")
    return given


def _laws(law: Any, laws: Any, cell_tags: Any) -> dict[Any, Law]:
    """Laws by sorted pair of cell tags, and that of all others by None."""
    accepted = "choose Tied(), Frictionless(), Coulomb(mu) or a law of your own"
    chosen: dict[Any, Law] = {}
    if law is not None:
        chosen[None] = checks.instance("law", law, Law, accepted)
    if laws is None:
        return chosen or {None: Tied()}
    if not isinstance(laws, Mapping) or not laws:
        checks.refuse("laws", laws, LAWS)
    if cell_tags is None:
        raise ContactInputError("laws by cell tags need these: give cell_tags")
    for key, one in laws.items():
        pair = checks.items("laws: key", key, LAWS)
        if len(pair) != 2:
            checks.refuse("laws: key", key, LAWS)
        both = tuple(sorted(checks.integer("laws: cell tag", tag, LAWS) for tag in pair))
        if both in chosen:
            raise ContactInputError(f"laws: {both} is there twice: give one law for each pair")
        chosen[both] = checks.instance(f"laws: {key}", one, Law, accepted)
    return chosen


def _check_keys(laws: dict[Any, Law], found: Sequence[_Found]) -> None:
    """Require that bodies have the cell tags by which there are laws."""
    known = np.unique(np.concatenate([np.zeros(0), *(v for f in found for v in f.tags.values())]))
    if missing := sorted({tag for key in laws if key is not None for tag in key} - set(known)):
        raise ContactInputError(
            f"laws: no body has the cell tags {missing}; there are {known.astype(int).tolist()}"
        )


def _reach(distance: Any, angle: Any) -> tuple[float | None, float]:
    """Distance and angle, checked."""
    if distance is not None:
        distance = checks.number("distance", distance, "give a positive length, or None", above=0.0)
    accepted = "give an angle between 0 and 1.5 [rad], or None"
    turn = ANGLE if angle is None else checks.number("angle", angle, accepted, above=0.0)
    if turn > 1.5:
        checks.refuse("angle", angle, accepted)
    return distance, turn


def _outside(V: Any, facet_tags: Any, cell_tags: Any, label: Array) -> _Found:
    """The facets of one mesh that are looked at; (n,) body of each of this rank's nodes."""
    mesh = V.mesh
    comm, fdim = mesh.comm, mesh.topology.dim - 1
    mesh.topology.create_connectivity(fdim, fdim + 1)
    mesh.topology.create_connectivity(fdim + 1, fdim)
    local = dolfinx_mesh.exterior_facet_indices(mesh.topology)
    if facet_tags is not None:
        local = np.unique(facet_tags.indices)
    check(comm, not comm.allreduce(len(local)), "there are no facets to look at", ContactInputError)
    local = np.sort(local).astype(np.int32)
    own = dolfinx_mesh.meshtags(mesh, fdim, local, np.ones(len(local), dtype=np.int32))
    surface = extract_surface(V, own, 1)
    body = gather_rows(comm, label)[surface.dofs[surface.facets[:, 0]]]
    cells, nodes = facet_nodes(V, local)
    dofs = compat.cell_dofs(V)[cells][np.arange(len(local))[:, None], nodes].astype(np.int32)
    dofs = V.dofmap.index_map.local_to_global(dofs.ravel()).reshape(dofs.shape)
    keys = np.sort(surface.dofs[surface.cells], axis=1)
    both = np.concatenate([keys, np.sort(dofs, axis=1)])
    _, place = np.unique(both, axis=0, return_inverse=True)
    place = place.ravel()
    at = np.empty(place.max(initial=-1) + 1, dtype=np.int64)
    at[place[: len(keys)]] = np.arange(len(keys))
    found = _Found(mesh, surface, body, local, at[place[len(keys) :]])
    if cell_tags is not None:
        found.tags.update(_tags_of(V, cell_tags, gather_rows(comm, label)))
    return found


def _tags_of(V: Any, cell_tags: Any, label: Array) -> dict[int, Array]:
    """The values that the cells of each body have; (n,) body of all nodes of all ranks."""
    node = compat.cell_dofs(V)[cell_tags.indices, 0].astype(np.int32)
    body = label[V.dofmap.index_map.local_to_global(node)]
    rows = np.unique(np.column_stack([body, cell_tags.values]), axis=0)
    rows = np.unique(gather_rows(V.mesh.comm, rows), axis=0)
    return {int(b): rows[rows[:, 0] == b, 1] for b in np.unique(rows[:, 0])}


def _ids(found: Sequence[_Found]) -> Array:
    """Body of all facets of all meshes, one after the other."""
    return np.concatenate([f.body for f in found])


def _interfaces(
    found: Sequence[_Found], i: Array, j: Array, laws: dict[Any, Law]
) -> list[Interface]:
    """One for each pair of bodies, of facets (k,), (k,) of all meshes that face each other."""
    body = _ids(found)
    space = np.repeat(np.arange(len(found)), [len(f.body) for f in found])
    start = np.cumsum([0, *(len(f.body) for f in found)])
    tags = {b: values for f in found for b, values in f.tags.items()}
    order = np.lexsort((body[j], body[i]))
    i, j = i[order], j[order]
    ends = np.flatnonzero(np.diff(body[i]) | np.diff(body[j])) + 1
    interfaces = []
    pairs = zip(np.split(i, ends), np.split(j, ends), strict=True)
    for facets in [face for pair in pairs for face in _faces(found, start, pair)]:
        names = [int(body[side[0]]) for side in facets]
        law = _law_between(names, tags, laws)
        if law is None:
            continue
        meshes = [int(space[side[0]]) for side in facets]
        chosen = [np.unique(side) - start[m] for side, m in zip(facets, meshes, strict=True)]
        if meshes[0] == meshes[1]:
            one = _mark(found[meshes[0]], chosen, names)
            sides = [one, one]
        else:
            sides = [
                _mark(found[m], [own], [b]) for m, own, b in zip(meshes, chosen, names, strict=True)
            ]
        interfaces.append(Interface(None, tuple(zip(sides, names, strict=True)), law=law))
    return interfaces


def _faces(
    found: Sequence[_Found], start: Array, facets: tuple[Array, Array]
) -> list[tuple[Array, Array]]:
    """Facets (k,), (k,) of two bodies that face each other, face by face; ``start`` (m,): the first
    facet of each mesh."""
    sides, at = [], []
    for own in facets:
        mesh = int(np.searchsorted(start, own[0], side="right")) - 1
        every, place = np.unique(own - start[mesh], return_inverse=True)
        surface = found[mesh].surface
        sides.append((surface.x, surface.facets[every]))
        at.append(place)
    face = faces(sides, at)
    return [(facets[0][face == k], facets[1][face == k]) for k in range(face.max() + 1)]


def _law_between(bodies: Sequence[int], tags: dict[int, Array], laws: dict[Any, Law]) -> Law | None:
    """Law of a pair of bodies; None: it is left out."""
    if list(laws) == [None]:
        return laws[None]
    values = [tags.get(body, np.zeros(0)) for body in bodies]
    for body, own in zip(bodies, values, strict=True):
        if len(own) != 1:
            raise ContactInputError(
                f"cell_tags: the cells of body {body} have the values {own[:9].tolist()}: each "
                "body needs one value, on all of its cells"
            )
    return laws.get(tuple(sorted(int(own[0]) for own in values)), laws.get(None))


def _mark(found: _Found, facets: Sequence[Array], values: Sequence[int]) -> Any:
    """Mesh tags of facets of a surface, (k,) each, by values."""
    value = np.full(len(found.surface.facets), -1, dtype=np.int32)
    for some, one in zip(facets, values, strict=True):
        value[some] = one
    own = value[found.number]
    marked = own >= 0
    dim = found.mesh.topology.dim - 1
    return dolfinx_mesh.meshtags(found.mesh, dim, found.local[marked], own[marked])
