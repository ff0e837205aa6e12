"""Nodes and cells of a physical group of a gmsh model."""

from __future__ import annotations

from typing import Any

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactInputError


def read_gmsh(model: Any, physical_group: int, gdim: int) -> tuple[Array, Array]:
    """Nodes and cells of a physical group of cells of one kind."""
    checks.integer("gdim", gdim, "give 2 or 3")
    if gdim not in (2, 3):
        checks.refuse("gdim", gdim, "give 2 or 3")
    checks.integer("physical_group", physical_group, "give the tag of a physical group, an integer")
    if not hasattr(model, "getPhysicalGroups") or not hasattr(model, "mesh"):
        checks.refuse("model", model, "give gmsh.model after gmsh.initialize()")
    try:
        return _read_group(model, physical_group, gdim)
    except ContactInputError:
        raise
    except Exception as error:
        raise ContactInputError(
            f"gmsh cannot read the physical group {physical_group}: {error}. Call "
            "gmsh.initialize(), then make or open a model and mesh it"
        ) from error


def _read_group(model: Any, physical_group: int, gdim: int) -> tuple[Array, Array]:
    nodes = {1: 2, 2: 3, 3: 4, 8: 3, 9: 6, 10: 9}  # gmsh's lines, triangles, quads
    kinds: set[int] = set()
    parts = [np.empty(0, dtype=np.int64)]
    groups = [(int(dim), int(tag)) for dim, tag in model.getPhysicalGroups()]
    if (gdim - 1, physical_group) in groups:
        for entity in model.getEntitiesForPhysicalGroup(gdim - 1, physical_group):
            found = model.mesh.getElements(gdim - 1, entity)
            kinds |= set(map(int, found[0]))
            parts += [np.asarray(tags, dtype=np.int64) for tags in found[2]]
    if len(kinds) != 1 or not kinds <= set(nodes):
        raise ContactInputError(
            f"physical group {physical_group} of dimension {gdim - 1}: cells must be lines "
            "(gdim=2), triangles or quads (gdim=3) of one kind, of 2 or 3, 3 or 6, 4 or 9 nodes; "
            f"gmsh's kinds there are "
            f"{sorted(kinds)}, and the model has the groups (dimension, tag) {groups}"
        )
    tags, x, _ = model.mesh.getNodes()
    used, cells = np.unique(np.concatenate(parts), return_inverse=True)
    order = np.argsort(tags)
    x = np.reshape(x, (-1, 3))[order[np.searchsorted(tags, used, sorter=order)], :gdim]
    return x, cells.reshape(-1, nodes[kinds.pop()])
