"""Traction at the nodes of second-order facets, from the forces there: p with ∫ N_p p dA = F_p, and
as few jumps of its slopes as next to no part of the integrals asks for (``kinks``).

Where a facet is in contact by next to nothing, its far nodes carry nothing that could tell their
values: these follow from the nearest facet that is. So do those of a facet that is covered in part
and says far more there than the nearest one that is covered: that is its quadratic, carried on
beyond an edge at which tractions rise steeply. Where bodies can only press, control values of the
pressure (``Element.bernstein``) are none negative, as those of the forces are.

Forces of bodies are as exact as their stresses, but what they say of the difference between nodes
at corners and in the middle of edges, which carries no resultant, is small and is found with errors
of its own size: corners of 6-node triangles came out low, by 0.4 h² Δp. A field of second order
that is smooth has no jumps of slopes between facets: a small part of their squares added to those
of p (as in interior penalty methods, Burman and Hansbo 2004) takes such errors away. Linear and
quadratic fields have none, resultants and moments stay, and the jumps of a smooth field fall with
h².

Of bodies that are tied, forces of the finer side follow the coarser one's facets, where the frame
is, and what they say is off by several times as much as the coarser side's traction, which turned
round is theirs as well (``with_coarser``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from dolfinx_llm.base.arrays import Array
from dolfinx_llm.geometry.cells import rigid_modes, shape_functions
from dolfinx_llm.geometry.element import CORNERS, Element
from dolfinx_llm.geometry.loads import assembled
from dolfinx_llm.geometry.pairs import ContactPairs

UNTOLD = 0.3  # part of a facet in contact, up to which it tells little of its far nodes
SURE = 0.9  # part from which on it tells all of them
OVERSHOT = 1.5  # of the traction on the nearest covered facet: what one covered in part may say
REMOVALS = 10  # in which those that say more are taken out
SMOOTH = 0.01  # part of the jumps' squares: nodes of Hertz's ellipse are off least from .003 to .03
OMISSIONS = 20  # in which nodes whose pressure would be negative are left out
OPEN_FORCE = 1e-8  # of the largest force: what an iteration may leave open
NONE = 1e-12  # of the largest traction: below it a pull is rounding
ONE_FIELD = 0.08  # of the largest traction, by which smooth ones of both sides differ at most
PLANE = 1e-6  # of a facet's size, that is none across it
CREASE = 0.7  # cosine of the angle between facets from which on there is an edge of the body


def density_at_nodes(
    pairs: ContactPairs,
    force: Array,
    presses: bool,
    mean: Array | None = None,
) -> Array | None:
    """(n, gdim) traction at the nodes of pairs [force / area]; None at first order, where it is
    force per area.

    Args:
        pairs: of one side.
        force: (n, gdim) forces of what the pairs are in: nodes, or control values.
        presses: bodies may part, and no pair pulls.
        mean: (n, gdim) traction that is taken where forces agree with it but for what an iteration
            leaves open, which next to the rim of contact is a larger part of tractions.
    """
    mass, cover = pairs.loads.mass, pairs.loads.cover
    if mass is None or cover is None:
        return None
    if not mass.diagonal().any():  # none of it is covered: a body stands on its corner
        return np.zeros_like(force) if mean is None else mean
    told = cover[pairs.cells].min(axis=1, initial=1.0)
    whole = told > UNTOLD
    if not whole.any():
        whole[:] = True
    for _ in range(REMOVALS):
        value = _from_whole(pairs, force, presses, mean, pairs.cells[whole])
        wild = whole & _steep(pairs, told, value)
        if not wild.any():
            break
        whole &= ~wild
    return value


def with_coarser(
    pairs: Sequence[ContactPairs], force: Sequence[Array], density: Sequence[Array | None]
) -> list[Array | None]:
    """Tractions of tied sides, that of the finer one read from the coarser one's: turned round, and
    with the motion of a rigid body added by which the finer side's resultant and moment are met.
    Where either side is covered in part, or both differ, as at steep ends which the finer one
    resolves better, they stay as they are.

    Args:
        pairs: of both sides.
        force: per side (n, c) forces at nodes.
        density: (n, c) what each says by itself; None: first order.
    """
    found, count = list(density), [len(p.nodes) for p in pairs]
    fine = int(count[1] > count[0])
    (p, q), own, other = (pairs[fine], pairs[1 - fine]), density[fine], density[1 - fine]
    if own is None or other is None or count[0] == count[1] or not all(map(_whole, pairs)):
        return found
    value = -(q.interpolation(p.x) @ other)
    modes = rigid_modes((p.x - p.x.mean(axis=0)) / np.ptp(p.x, axis=0).max(), value.shape[1])
    felt = (p.loads.mass @ modes.reshape(len(value), -1)).reshape(modes.shape)
    lacking = np.einsum("nck,nc->k", modes, force[fine]) - np.einsum("nck,nc->k", felt, value)
    share = np.linalg.solve(np.einsum("nck,ncl->kl", felt, modes), lacking)
    value = value + np.einsum("nck,k->nc", modes, share)
    away, size = (np.linalg.norm(v, axis=1).max(initial=0.0) for v in (own - value, own))
    if away <= ONE_FIELD * size:
        found[fine] = value
    return found


def _whole(pairs: ContactPairs) -> bool:
    """Whether all facets of a side are in contact, each of them whole."""
    cover = pairs.loads.cover
    return cover is not None and len(pairs.cells) > 0 and bool((cover[pairs.cells] > SURE).all())


def _from_whole(
    pairs: ContactPairs, force: Array, presses: bool, mean: Array | None, whole: Array
) -> Array:
    """The same, of what facets (m, k) tell; others follow them."""
    mass, E = pairs.loads.mass, pairs.control
    if E is None:
        E = identity(len(force), format="csr")
    T = _extension(pairs, whole, linear=not presses)
    thickness = 1.0 if pairs.surface.thickness is None else pairs.surface.thickness.mean()
    mass = mass + SMOOTH * thickness * kinks(pairs.x, whole, pairs.surface.element)
    mass, felt = (T.T @ E.T @ mass @ E @ T).tocsr(), T.T @ force
    used = np.asarray(mass.diagonal() > 0.0)
    least = 0.0 if mean is None else OPEN_FORCE * np.abs(felt).max(initial=0.0)
    for _ in range(OMISSIONS):
        value = np.zeros_like(force)
        if mean is not None:
            value[used] = mean[used]
        rest = (felt - mass @ value)[used]
        value[used] += _solved(mass[used][:, used], np.where(np.abs(rest) > least, rest, 0.0))
        normal = np.einsum("ni,ni->n", value, pairs.normal)
        pulls = used & (normal < -NONE * np.abs(value).max(initial=0.0))
        if not (presses and pulls.any()):
            break
        used &= ~pulls
    return np.asarray(E @ (T @ value))


def along_normals(vector: Array, normal: Array) -> Array:
    """(m, 1 + gdim) the part of vectors (m, gdim) along normals, and what is left."""
    part = np.einsum("mi,mi->m", vector, normal)[:, None]
    return np.column_stack([part, vector - part * normal])


def _solved(mass: csr_matrix, force: Array) -> Array:
    """Densities (k, gdim) of forces, by the integrals of shape functions' products (k, k)."""
    root = 1.0 / np.sqrt(mass.diagonal())  # facets hardly in contact weigh less
    scaled = (diags(root) @ mass @ diags(root)).tocsc()
    return np.asarray(root[:, None] * splu(scaled).solve(root[:, None] * force))


def _steep(pairs: ContactPairs, told: Array, value: Array) -> Array:
    """(m,) facets, of which a part (m,) is covered, whose tractions (n, gdim) are far beyond those
    of the nearest facet that is covered."""
    size = np.linalg.norm(value, axis=1)[pairs.cells].max(axis=1, initial=0.0)
    covered = told > SURE
    if covered.all() or not covered.any():
        return np.zeros(len(told), dtype=bool)
    centre = pairs.x[pairs.cells].mean(axis=1)
    nearest = np.flatnonzero(covered)[cKDTree(centre[covered]).query(centre)[1]]
    return np.asarray(~covered & (size > OVERSHOT * size[nearest] + NONE * size.max()))


def _extension(pairs: ContactPairs, whole: Array, linear: bool) -> csr_matrix:
    """(n, n) values at all nodes from those of whole facets (m, k): at the others what the nearest
    of these facets says, its linear field or its nearest node's value."""
    n, sound = len(pairs.nodes), np.zeros(len(pairs.nodes), dtype=bool)
    sound[whole] = True
    if sound.all() or not len(whole):
        return identity(n, format="csr")
    weak, x = np.flatnonzero(~sound), pairs.x
    centre = x[whole].mean(axis=1)
    nearest = whole[cKDTree(centre).query(x[weak])[1]]
    if linear:
        nearest = nearest[:, : pairs.surface.facets.shape[1]]
        middle = x[nearest].mean(axis=1, keepdims=True)
        slopes = np.linalg.pinv(x[nearest] - middle, rcond=PLANE)
        weight = 1.0 / nearest.shape[1] + np.einsum("wi,wik->wk", x[weak] - middle[:, 0], slopes)
    else:
        away = np.linalg.norm(x[nearest] - x[weak][:, None], axis=2)
        weight = np.zeros(nearest.shape)
        np.put_along_axis(weight, away.argmin(axis=1)[:, None], 1.0, axis=1)
    row = np.concatenate([np.flatnonzero(sound), np.repeat(weak, weight.shape[1])])
    column = np.concatenate([np.flatnonzero(sound), nearest.ravel()])
    value = np.concatenate([np.ones(int(sound.sum())), weight.ravel()])
    return csr_matrix((value, (row, column)), (n, n))


def kinks(x: Array, cells: Array, element: Element) -> csr_matrix:
    """(n, n) sums of ∫ h³ [∂N/∂ν] [∂N/∂ν] over what facets (m, k) with nodes at x (n, gdim) share,
    edges or in 2D nodes; ν points out of a facet along it, h is the smaller one's extent along ν.
    """
    n = len(x)
    slopes, out, size, weight, key = (np.concatenate(a) for a in zip(*_sides(x, cells, element)))
    order = np.lexsort(key.T)
    same = (key[order[1:]] == key[order[:-1]]).all(axis=1)
    one, two = order[:-1][same], order[1:][same]
    flat = np.einsum("sgi,sgi->sg", out[one], out[two]).max(axis=1) < -CREASE
    one, two = one[flat], two[flat]
    nodes = np.tile(cells, (len(key) // max(len(cells), 1), 1))
    nodes = np.concatenate([nodes[one], nodes[two]], axis=1)
    jump = np.concatenate([slopes[one], slopes[two]], axis=2)
    scale = weight[one] * np.minimum(size[one], size[two])[:, None] ** 3
    blocks = np.einsum("sg,sgk,sgl->skl", scale, jump, jump)
    return assembled(blocks, nodes, n) if len(blocks) else csr_matrix((n, n))


def _sides(x: Array, cells: Array, element: Element) -> list[tuple[Array, ...]]:
    """Per side of the facets, at g points: slopes of the shape functions along ν (m, g, k), ν
    (m, g, gdim), extents (m,), weights (m, g) and the nodes at its ends (m, 2)."""
    corner = CORNERS[element.corners]
    found: list[tuple[Array, ...]] = []
    t, w = np.polynomial.legendre.leggauss(2 * element.dim - 1)
    ends = element.edges if element.dim > 1 else np.array([[0, 0], [1, 1]])
    reach = 2.0 if element.corners == 4 else element.corners  # from the centre, of the extent
    for side in ends:
        key = cells[:, side]
        turned = key[:, 0] > key[:, 1]  # points from the same end for both facets
        s = np.where(turned[:, None], -t, t)[..., None]
        a, b = corner[side]
        xi = 0.5 * ((1.0 - s) * a + (1.0 + s) * b)
        N, dN = shape_functions(element.nodes, xi.reshape(-1, element.dim))
        N, dN = N.reshape(*xi.shape[:2], -1), dN.reshape(*xi.shape[:2], -1, element.dim)
        p = x[cells]
        tangents = np.einsum("mgkd,mki->mgdi", dN, p)
        across, length = _across(tangents, b - a)
        middle = np.einsum("mgk,mki->mgi", N, p).mean(axis=1)
        away = middle - p[:, : element.corners].mean(axis=1)
        extent = reach * np.einsum("mi,mgi->mg", away, across).mean(axis=1)
        across = across * np.sign(extent)[:, None, None]
        metric = np.einsum("mgdi,mgei->mgde", tangents, tangents)
        along = np.einsum("mgdi,mgi->mgd", tangents, across)
        slope = np.einsum("mgkd,mgd->mgk", dN, np.linalg.solve(metric, along[..., None])[..., 0])
        found.append((slope, across, np.abs(extent), 0.5 * w * length, np.sort(key, axis=1)))
    return found


def _across(tangents: Array, way: Array) -> tuple[Array, Array]:
    """Unit vectors (m, g, gdim) along facets and across a side of theirs that runs along ``way``
    (d,), whose tangents are (m, g, d, gdim), and its length per reference length (m, g)."""
    along = np.einsum("d,mgdi->mgi", way, tangents)
    if tangents.shape[2] == 1:
        line = tangents[:, :, 0]
        return line / np.linalg.norm(line, axis=2, keepdims=True), np.ones(line.shape[:2])
    length = np.linalg.norm(along, axis=2)
    across = np.cross(along, np.cross(tangents[:, :, 0], tangents[:, :, 1]))
    return across / np.linalg.norm(across, axis=2, keepdims=True), length
