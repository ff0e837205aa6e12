"""An interface ready for assembly: the outcome of ``build``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.geometry.pairs import ContactPairs
from dolfinx_llm.geometry.surface import Surface
from dolfinx_llm.interface.certificate import Certificate
from dolfinx_llm.interface.choices import Interface


@dataclass(frozen=True, eq=False)
class ContactModel:
    """An interface, ready for assembly; the same on every rank."""

    interface: Interface  # the user's choices
    sides: tuple[Surface, ...]  # two; one against a rigid obstacle
    spaces: tuple[int, ...]  # index of the function space of each side
    pairs: tuple[ContactPairs, ...]  # of each side
    frame: Frame | None  # None against a rigid obstacle
    directions: np.ndarray  # (m, d, gdim) directions in which the frame's nodes move
    area: float  # of contact, for laws that let bodies part the area where they may touch [area]
    certificate: Certificate | None  # None against a rigid obstacle
    rims: tuple[np.ndarray, ...]  # per side (n,) pairs next to facets that were left out
    notes: tuple[str, ...]  # what was chosen or left out, and why
    times: dict[str, float]  # seconds per stage
