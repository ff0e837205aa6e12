"""What has changed in the data of the bodies since they were last asked."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import ufl


@dataclass(frozen=True)
class Changes:
    """Which data are other ones than before; the same on all ranks."""

    stiffness: bool = False  # a Constant or Function of a form a
    conditions: bool = False  # which dofs are prescribed; their values belong to the load
    positions: bool = False  # of a mesh's nodes

    def __bool__(self) -> bool:
        return self.stiffness or self.conditions or self.positions

    @property
    def names(self) -> list[str]:
        """Of the data that have changed."""
        return [name for name, changed in vars(self).items() if changed]

    def __or__(self, other: Changes) -> Changes:
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Changes(*(a or b for a, b in pairs))


class Fingerprint:
    """Digests of all that the stiffness and the contact surfaces are made of: bilinear forms and
    meshes."""

    def __init__(self, forms: Sequence[ufl.Form], spaces: Sequence[Any]) -> None:
        self._comm = spaces[0].mesh.comm
        self._geometries = [V.mesh.geometry for V in spaces]
        self._coefficients = [c for form in forms for c in form.coefficients()]
        self._constants = [c for form in forms for c in form.constants()]
        self._seen: list[bytes] | None = None

    def changes(self, fixed: Iterable[np.ndarray]) -> Changes:
        """Compare with the call before; collective. Per mesh (n,) which of this rank's dofs are
        prescribed."""
        values = [c.x.array for c in self._coefficients if hasattr(c, "x")]
        values += [c.value for c in self._constants]
        now = [_digest(values), _digest(fixed), _digest(g.x for g in self._geometries)]
        before, self._seen = self._seen or now, now
        differ = np.array([a != b for a, b in zip(before, now, strict=True)], dtype=np.int64)
        return Changes(*(bool(n) for n in self._comm.allreduce(differ)))


def _digest(arrays: Iterable[np.ndarray]) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.digest()
