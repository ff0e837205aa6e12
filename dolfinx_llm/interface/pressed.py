"""Obstacles under a prescribed force: their translations are unknowns, as a frame node's are."""

from dataclasses import replace

import numpy as np
from scipy.sparse import csr_matrix

from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.interface.geometry import InterfaceGeometry
from dolfinx_llm.interface.obstacle import Obstacle

RESISTED = 1e-6  # part of the largest: below it a motion meets no resistance of contact
REST = 1e-9  # part of a force that rounding may put across what contact resists


def forced(obstacle: Obstacle, gdim: int) -> tuple[bool, ...]:
    """Per component whether a force on the obstacle is prescribed."""
    return tuple(f is not None for f in obstacle.pose(gdim)[-1])


def under_force(
    obstacle: Obstacle, pairs: ContactPairs, unilateral: bool
) -> tuple[ContactPairs, np.ndarray]:
    """Translations of an obstacle that forces are prescribed for, as those of a frame of one node:
    the pairs, whose rows all see that node, and (1, d, gdim) directions in which it moves: the axes
    of the prescribed components, or what of them contact can resist. No force: (0, c, gdim)."""
    _, c, gdim = pairs.base.shape
    axes = np.eye(gdim)[list(forced(obstacle, gdim))]
    if not len(axes):
        return pairs, np.empty((0, c, gdim))
    if not unilateral:
        raise ContactInputError(
            f"force={obstacle.force} on the {type(obstacle).__name__}: forces on obstacles are for "
            "Frictionless() and Coulomb(mu); with Tied() prescribe the displacement"
        )
    _, size, vectors = np.linalg.svd(pairs.base.reshape(-1, gdim) @ axes.T)
    resisted = size > RESISTED * size[0]
    if not resisted.all() or len(size) < len(axes):
        axes = vectors[: int(resisted.sum())] @ axes
    return replace(pairs, N=csr_matrix(np.ones((len(pairs.nodes), 1)))), axes[None]


def prescribed_loads(model: InterfaceGeometry) -> np.ndarray:
    """(m d,) loads on the frame unknowns of an interface, L_bᵀ λ = loads, as they are now: zeros at
    a frame, minus the force at an obstacle [force]."""
    obstacle, axes = model.interface.obstacle, model.directions
    loads = np.zeros(axes.shape[0] * axes.shape[1])
    if obstacle is None:
        return loads
    force = obstacle.pose(axes.shape[2])[-1]
    if forced(obstacle, axes.shape[2]) != model.forced:
        raise ContactInputError(
            f"force={force} of the {type(obstacle).__name__}: when the problem was made, force was "
            f"prescribed by component as {model.forced}. Make the problem anew to change that"
        )
    if not any(model.forced):
        return loads
    values = np.array([0.0 if f is None else f for f in force])
    along = axes[0] @ values
    left = values - along @ axes[0]
    if np.abs(left).max() > REST * np.abs(values).max():
        raise ContactError(
            f"interface {model.interface.name}: nothing resists the part {left.round(9).tolist()} "
            f"of the force {values.tolist()} on the {type(obstacle).__name__}. Give None for "
            "components whose displacement is prescribed, or take a law with friction"
        )
    return -along
