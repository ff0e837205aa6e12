"""Forces at the nodes of prescribed sides, from those of the other side."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix

import dolfinx_llm as llm
from dolfinx_llm.geometry.frame import Frame
from dolfinx_llm.interface.tool_forces import check_beside, tool_shares


def line(x):
    return Frame(
        np.column_stack([x, 0.0 * x]), np.column_stack([np.arange(len(x) - 1)] * 2) + [0, 1]
    )


def on_the_tool(force, across=41):
    """Shares for forces (5, 2) at x = -2..2 of a side on a tool from -1.4 to 1.4, and its nodes."""
    x, y = np.linspace(-2.0, 2.0, 5), np.linspace(-1.4, 1.4, across)
    side, tool = line(x), line(y)
    opposite = side.interpolation(side.locate(tool.x))
    rows = tool.interpolation(tool.locate(side.x))  # continued beyond the rim
    far = 2.8 / (across - 1)
    own = np.full(across, far)
    own[[0, -1]] *= 0.5
    # Of facets from 1 to 2, covered from 1 to 1.4.
    outer, inner = 0.4**2 / 2, 0.4 - 0.4**2 / 2
    theirs = np.array([outer, 0.5 + inner, 1.0, 0.5 + inner, outer])
    shares = tool_shares(opposite, rows, (theirs, own), side.x, tool.x, force, rows.T @ force)
    return shares, theirs, own, x, y


def test_constant_pressure():
    """Shared by areas."""
    theirs = on_the_tool(np.ones((5, 2)))[1]
    shares, _, own, _, _ = on_the_tool(np.column_stack([0.0 * theirs, theirs]))
    assert np.abs(shares @ theirs - own).max() < 1e-13


@pytest.mark.parametrize("force", [[1, 5, 3, 2, 0.5], [0, 0, 1, 3, 1], [0, 0, 0, 1, 0.2]])
def test_moment_without_pulls(force):
    """Rows have entries of both signs where the side's nodes lie beside the tool."""
    normal = np.array(force, dtype=float)
    both = np.column_stack([0.3 * normal, normal])
    shares, _, _, x, y = on_the_tool(both)
    assert shares.min() >= 0.0
    found = shares @ both
    assert np.abs(found.sum(axis=0) - both.sum(axis=0)).max() < 1e-13 * normal.sum()
    assert abs(found[:, 1] @ y - normal @ x) < 1e-11 * normal.sum()
    assert np.abs(found[:, 0] - 0.3 * found[:, 1]).max() < 1e-13  # in the cone of friction


def test_beside_the_tool():
    """No forces that press have the moment of one beside it."""
    assert on_the_tool(np.array([[0.0, 0.0]] * 4 + [[0.0, 1.0]]))[0] is None
    assert on_the_tool(np.zeros((5, 2)))[0] is None
    with pytest.raises(llm.ContactError, match="beside tag 1, .* by up to 50.0%"):
        check_beside("1 | 2", ("tag 2", "tag 1"), (np.array([2.0]), np.array([3.0, -1.0])), 1)
    check_beside("1 | 2", ("tag 2", "tag 1"), (np.array([2.0]), np.array([2.0, -1e-6])), 1)
    check_beside("1 | 2", ("tag 2", "tag 1"), (np.array([2.0, -1.0]), np.array([2.0, -1.0])), 1)


def test_rows_alone():
    """A pair that no node of the tool lies opposite of is shared as its row says."""
    opposite = csr_matrix(np.array([[1.0, 0.0], [1.0, 0.0]]))
    rows = csr_matrix(np.array([[0.5, 0.5], [0.25, 0.75]]))
    x, y = np.array([[0.5, 0.0], [0.75, 0.0]]), np.array([[0.0, 0.0], [1.0, 0.0]])
    force = np.array([[0.0, 1.0], [0.0, 1.0]])
    areas = np.array([0.5, 0.5]), np.array([0.375, 0.625])
    shares = tool_shares(opposite, rows, areas, x, y, force, rows.T @ force)
    assert np.abs((shares @ force)[:, 1] - [0.75, 1.25]).max() < 1e-12
