"""Surfaces that several interfaces have."""

from types import SimpleNamespace

import numpy as np
import pytest

import dolfinx_llm as llm
from dolfinx_llm.interface.shared import check_once


def test_surfaces_that_several_interfaces_have():
    """A pair of surfaces is given once; two that meet each other may both meet a third one."""
    ties = [SimpleNamespace(name=name, obstacle=None) for name in ("a", "b")]
    a, b, c = (np.array([[k, k + 1], [k + 1, k + 2]]) for k in (0, 10, 20))
    check_once(ties, [[a, b], [np.concatenate([a, b]), c]])
    check_once(ties, [[a], [b]])
    for other in ([b, a], [a, b], [np.concatenate([c, b])[:, ::-1], a[:1]]):
        with pytest.raises(llm.ContactInputError, match="facets of both sides in common"):
            check_once(ties, [[a, b], other])
