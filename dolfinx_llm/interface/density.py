"""Traction at the nodes of second-order facets, from the forces there: p with ∫ N_p p dA = F_p, and
as few jumps of its slopes as next to no part of the integrals asks for (``kinks``).

Where a facet is in contact by next to nothing, its far nodes carry nothing that could tell their
values: these follow from the nearest facet that is. Where bodies can only press, control values of
the pressure (``Element.bernstein``) are none negative, as those of the forces are.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix, diags, identity
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree

from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.interface.kinks import kinks

SMOOTH = 0.01  # part of the jumps' squares: nodes of Hertz's ellipse are off least from .003 to .03
OMISSIONS = 20  # in which nodes whose pressure would be negative are left out
NONE = 1e-12  # of the largest traction: below it a pull is rounding
PLANE = 1e-6  # of a facet's size, that is none across it


def density_at_nodes(
    pairs: ContactPairs, force: np.ndarray, presses: bool = False
) -> np.ndarray | None:
    """(n, gdim) traction at the nodes of pairs [force / area]; None at first order, where it is
    force per area.

    Args:
        pairs: of one side.
        force: (n, gdim) forces of what the pairs are in: nodes, or control values.
        presses: bodies may part, and no pair pulls.
    """
    mass, E = pairs.loads.mass, pairs.control
    if mass is None:
        return None
    if E is None:
        E = identity(len(force), format="csr")
    whole = _whole(pairs)
    T = _extension(pairs, whole, linear=not presses)
    mass = mass + SMOOTH * kinks(pairs.x, whole, pairs.surface.element)
    mass, felt = (T.T @ E.T @ mass @ E @ T).tocsr(), T.T @ force
    used = np.asarray(mass.diagonal() > 0.0)
    for _ in range(OMISSIONS):
        value = np.zeros_like(force)
        value[used] = _solved(mass[used][:, used], felt[used])
        normal = np.einsum("ni,ni->n", value, pairs.normal)
        pulls = used & (normal < -NONE * np.abs(value).max(initial=0.0))
        if not (presses and pulls.any()):
            break
        used &= ~pulls
    return np.asarray(E @ (T @ value))


def _solved(mass: csr_matrix, force: np.ndarray) -> np.ndarray:
    """Densities (k, gdim) of forces, by the integrals of shape functions' products (k, k)."""
    root = 1.0 / np.sqrt(mass.diagonal())  # facets hardly in contact weigh less
    scaled = (diags(root) @ mass @ diags(root)).tocsc()
    return np.asarray(root[:, None] * splu(scaled).solve(root[:, None] * force))


def _whole(pairs: ContactPairs) -> np.ndarray:
    """(m, k) facets that are in contact by enough; all where none is."""
    assert pairs.loads.sound is not None
    whole = pairs.loads.sound[pairs.cells].all(axis=1)
    return pairs.cells[whole if whole.any() else slice(None)]


def _extension(pairs: ContactPairs, whole: np.ndarray, linear: bool) -> csr_matrix:
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
