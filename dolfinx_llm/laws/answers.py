"""What a contact law answers, asked for and checked: one of your own may return what fits no node.

Wrong shapes and types are errors of input. Values that are no finite numbers are errors of an
iterate: at finite deformation a smaller increment may come by without them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dolfinx_llm.base import checks
from dolfinx_llm.base.arrays import Array
from dolfinx_llm.base.errors import ContactError, ContactInputError
from dolfinx_llm.laws.rows import LawNodes, LawRows

if TYPE_CHECKING:
    from dolfinx_llm.laws.law import Law

Parts = dict[str, tuple[Any, list[tuple[int, ...]]]]  # values and the shapes they may have


def rows_of(law: Law, nodes: LawNodes) -> LawRows:
    """The law linearised about an iterate.

    Args:
        law: of any kind.
        nodes: what it is told.

    Raises:
        ContactInputError: its rows do not fit the nodes.
        ContactError: values that are not finite.
    """
    rows, (k, q) = law.rows(nodes), nodes.jump.shape
    shapes = {"status": (k,), "C_T": (k, q, q), "C_jump": (k, q, q), "C_N": (k, q), "rhs": (k, q)}
    parts: Parts = {part: (getattr(rows, part, None), [shape]) for part, shape in shapes.items()}
    if getattr(rows, "weight", None) is not None:
        parts["weight"] = rows.weight, [(k,)]
    holds = getattr(rows, "holds", None)
    parts["holds"] = np.zeros(k) if holds is None else holds, [(k,), ()]
    _require(f"rows of {_named(law)}", parts, k, q)
    return replace(rows, holds=np.broadcast_to(np.asarray(parts["holds"][0], bool), (k,)).copy())


def spring_of(law: Law, nodes: LawNodes) -> tuple[Array, Array]:
    """Forces (k, q) and their derivative (k, q, q), or (k, q), of a law that tells ``force``.

    Args:
        law: with ``force``.
        nodes: what it is told.

    Raises:
        ContactInputError: they do not fit the nodes.
        ContactError: values that are not finite.
    """
    told, (k, q) = law.force(nodes), nodes.jump.shape
    if not isinstance(told, (tuple, list)) or len(told) != 2:
        checks.refuse(
            f"force of {_named(law)}", told, "return two arrays, forces and their derivative"
        )
    force, stiffness = told
    parts: Parts = {"forces": (force, [(k, q)]), "derivative": (stiffness, [(k, q, q), (k, q)])}
    _require(f"force of {_named(law)}", parts, k, q)
    return np.asarray(force), np.asarray(stiffness)


def kept_by(law: Law, asked: str, nodes: LawNodes) -> dict[str, Array]:
    """Arrays by name, each with an entry per node; what else they say is the law's own.

    Args:
        law: of any kind.
        asked: "start", "begin_step" or "end_step".
        nodes: what it is told.

    Raises:
        ContactInputError: something else, or not what the law kept before.
    """
    kept, k = getattr(law, asked)(nodes), len(nodes.x)
    name = f"{asked} of {_named(law)}"
    if not isinstance(kept, dict):
        checks.refuse(name, kept, "return a dict of arrays, {} where there is nothing to keep")
    kept = {part: np.asarray(value) for part, value in kept.items()}
    before = nodes.history if asked == "end_step" else {}
    wrong = [f"{part} of shape {v.shape}" for part, v in kept.items() if v.shape[:1] != (k,)]
    for part in before:
        if part not in kept:
            wrong.append(f"nothing for {part}")
        elif kept[part].shape != np.shape(before[part]):
            wrong.append(f"{part} of shape {kept[part].shape}, {np.shape(before[part])} before")
    if wrong:
        raise ContactInputError(
            f"{name} returns {'; '.join(wrong)}: return an array with an entry for each of {k} "
            "nodes, the same in each step"
        )
    return kept


def at_nodes(law: Law, asked: str, nodes: LawNodes) -> Array:
    """(k,) values at the nodes.

    Args:
        law: of any kind.
        asked: "miss", "strength" or "at_stake".
        nodes: what it is told.

    Raises:
        ContactInputError: they do not fit the nodes.
        ContactError: values that are not finite.
    """
    values, k = getattr(law, asked)(nodes), len(nodes.x)
    _require(f"{asked} of {_named(law)}", {"values": (values, [(k,)])}, *nodes.jump.shape)
    return np.asarray(values)


def _named(law: Law) -> str:
    return f"the law {checks.shown(law)}"


def _require(name: str, parts: Parts, k: int, q: int) -> None:
    """Require real, finite arrays of one of the shapes each."""
    wrong, unbounded = [], []
    for part, (value, shapes) in parts.items():
        value = np.asarray(value)
        if value.dtype.kind not in "biuf":
            wrong.append(f"{part} of type {value.dtype}, not of real numbers")
        elif value.shape not in shapes:
            wrong.append(f"{part} of shape {value.shape}, not {' or '.join(map(str, shapes))}")
        elif not np.isfinite(value).all():
            unbounded.append(f"{part} with {np.sum(~np.isfinite(value))} values")
    if wrong:
        raise ContactInputError(f"{name}: {'; '.join(wrong)}, for {k} nodes and {q} components")
    if unbounded:
        raise ContactError(f"{name}: {'; '.join(unbounded)} that are not finite, at {k} nodes")
