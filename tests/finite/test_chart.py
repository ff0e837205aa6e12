"""Functions along which corrections of rows of a moving frame change next to nothing."""

import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.spatial.transform import Rotation

from dolfinx_llm.finite.frame.chart import bordered, chart, functions_of
from dolfinx_llm.finite.frame.design import FAINT
from dolfinx_llm.geometry.element import element_of

pytestmark = pytest.mark.quick


def test_across():
    """In the plane, at second order: that across a circle belongs to them, none of a straight line
    does; they are orthogonal."""
    element, angle = element_of(1, 3), np.arange(0.0, 2.0 * np.pi, 0.1)
    ring = np.column_stack([2.0 * np.cos(angle), 2.0 * np.sin(angle)])
    straight = np.column_stack([angle, 0.5 * angle])
    of_line = np.tile([-0.5, 1.0] / np.hypot(0.5, 1.0), (len(angle), 1))
    for Y, normals, many in ((ring, 0.5 * ring, 5), (straight, of_line, 3)):
        found = chart(Y, normals, element, np.ones(len(Y)))
        assert found.shape == (len(Y), functions_of(element))
        expected = np.diag(np.arange(5) < many).astype(float)
        assert np.abs(found.T @ found / len(Y) - expected).max() < 1e-12
    functions = chart(ring, 0.5 * ring, element, np.ones(len(ring)))
    of_ring = functions @ np.linalg.lstsq(functions, ring, rcond=None)[0]
    assert np.abs(of_ring - ring).max() < 1e-12


def test_functions_may_depend_on_each_other():
    """A column of zeros, and one that is another's double, leave r balanced."""
    from scipy.sparse import diags

    rng = np.random.default_rng(3)
    M, r = diags(rng.uniform(1.0, 2.0, 6), format="csr"), rng.standard_normal(6)
    one = rng.standard_normal(6)
    G = np.column_stack([one, 2.0 * one, np.zeros(6)])
    mu, kappa = bordered(M, 0.0, G, r, 1e-9 * np.array([0.0, 1.0, 1.0]))
    assert np.abs(M @ mu + G @ kappa - r).max() < 1e-7
    assert np.abs(one @ mu) < 1e-7


def test_short_tube():
    """Closed, shorter than twice its radius: the plane of its circle is not along it, since 1, x²
    and y² depend on each other there; z and z², which rows reproduce, belong to them. None of x and
    y is across it: how the tube is turned does not matter."""
    angle, z = np.meshgrid(np.arange(0.0, 2.0 * np.pi, 0.1), np.linspace(-0.4, 0.4, 5))
    normals = np.column_stack([np.cos(angle).ravel(), np.sin(angle).ravel(), np.zeros(angle.size)])
    Y = 2.0 * normals + np.outer(z.ravel(), [0.0, 0.0, 1.0])
    turn = Rotation.from_rotvec([0.0, 0.0, 0.4]).as_matrix()
    for nodes, many in ((4, 4), (9, 9)):
        element, every = element_of(2, nodes), np.ones(len(Y))
        found = chart(Y, normals, element, every)
        assert found.shape == (len(Y), many)
        assert np.abs(found.T @ found / len(Y) - np.eye(many)).max() < 1e-12
        wanted = np.column_stack([Y, Y[:, 2] ** 2]) if nodes == 9 else Y
        told = found @ np.linalg.lstsq(found, wanted, rcond=None)[0]
        assert np.abs(told - wanted).max() < 1e-12
        turned = chart(Y @ turn.T, normals @ turn.T, element, every)
        assert np.abs(turned @ turned.T - found @ found.T).max() < 1e-10


def test_parts_that_share_no_row():
    """Each has its own moments, which no correction of its rows removes and functions of all parts
    do not tell: the others are told as if these were not there. A faint part of 1e-13 left 1e-3."""
    x = np.linspace(0.0, 1.0, 6)
    own = np.linalg.qr(np.column_stack([np.ones(6), x]))[0]
    removes = np.kron(np.eye(2), np.eye(6) - own @ own.T)
    G = np.column_stack([np.ones(12), np.concatenate([x, x + 3.0])])
    r = np.random.default_rng(4).standard_normal(12)
    held = csr_matrix(removes + FAINT * np.eye(12))
    mu, kappa = bordered(held, FAINT, G, r, np.zeros(2))
    assert np.abs(removes @ mu - removes @ (r - G @ kappa)).max() < 1e-4
    assert np.abs(G.T @ mu).max() < 1e-5 * np.abs(mu).max()
