"""What GAMG is told of the unknowns: how many belong to a node, and their rigid modes."""

from __future__ import annotations

import numpy as np

from dolfinx_llm.operators.bodies import rigid_modes
from dolfinx_llm.operators.system import ContactOperators


def block_size(operators: ContactOperators) -> int:
    """Frame unknowns per node where all frames have as many, else 1."""
    sizes = {model.directions.shape[1] for model in operators.models if len(model.directions)}
    return sizes.pop() if len(sizes) == 1 else 1


def rigid_modes_of(operators: ContactOperators) -> tuple[np.ndarray, np.ndarray]:
    """Rigid modes at this rank's dofs of the bodies (n_local, k) and at all frame unknowns (m, k),
    about the middle of the scene and of its size, so that far coordinates cost no digits."""
    bodies = operators.bodies
    low, high = bodies.low.min(axis=0), bodies.high.max(axis=0)
    centre, size = 0.5 * (low + high), np.linalg.norm(high - low)
    body = rigid_modes((bodies.points - centre) / size)
    frame = [
        np.einsum("mdi,mik->mdk", model.directions, rigid_modes((model.places - centre) / size))
        for model in operators.models
    ]
    k = body.shape[2]
    return body.reshape(-1, k), np.concatenate(
        [np.empty((0, k)), *(modes.reshape(-1, k) for modes in frame)]
    )
