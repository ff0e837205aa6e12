"""The frame of a straight line in closed form, and the 2D patch test, against exact values."""

import types

import numpy as np
import patch2d
import pytest
from conftest import run_mpi_json
from mpi4py import MPI
from sampling import drawn, longer

from dolfinx_llm import ContactError, Frame
from dolfinx_llm.design import line
from dolfinx_llm.design.line_nodes import choose_nodes, moment_roots, nearest_nodes


def nodes(rng, n, low, high, jitter):
    x = np.linspace(0.0, 1.0, n + 1)
    x[1:-1] += rng.uniform(-jitter, jitter, n - 1) / n
    return low + (high - low) * x


def forces(x, area):
    """Integrals of hat functions over the area by Simpson's rule on each piece: exact."""
    f = np.zeros(len(x))
    for k, (left, right) in enumerate(zip(x[:-1], x[1:], strict=True)):
        a, b = max(left, area[0]), min(right, area[1])
        if b > a:
            t = (np.array([a, 0.5 * (a + b), b]) - left) / (right - left)
            weight = (b - a) * np.array([1.0, 4.0, 1.0]) / 6.0
            f[k], f[k + 1] = f[k] + weight @ (1.0 - t), f[k + 1] + weight @ t
    return f


def hats(Y, x):
    """(n, m) values of the frame's shape functions."""
    return np.array([np.interp(x, Y, e) for e in np.eye(len(Y))]).T


def sides_in_contact(x0, x1):
    area = max(x0[0], x1[0]), min(x0[-1], x1[-1])
    f = [forces(x, area) for x in (x0, x1)]
    return [x[g > 0.0] for x, g in zip((x0, x1), f, strict=True)], [g[g > 0.0] for g in f], area


def residual(Y, x, f):
    r = hats(Y, x[0]).T @ f[0] - hats(Y, x[1]).T @ f[1]
    return np.abs(r).max() / max(f[0].max(), f[1].max())


@pytest.mark.parametrize(
    ("overlap", "scale"), drawn(["full", "shifted", "inside"], [1e-6, 1.0, 1e6], every=2)
)
def test_random_lines(overlap, scale):
    rng = np.random.default_rng(2001)
    ends = {"full": (0.0, 1.0), "shifted": (0.213, 1.4), "inside": (0.171, 0.83)}[overlap]
    for trial in range(60):
        n0 = int(rng.integers(1, 40))
        n1 = max(1, round(n0 * 10.0 ** rng.uniform(-1.0, 1.0)))
        jitter = 0.4 * (trial % 2)
        x0, x1 = nodes(rng, n0, 0.0, 1.0, jitter), nodes(rng, n1, *ends, jitter)
        x, f, area = sides_in_contact(scale * x0, scale * x1)
        roots = moment_roots(*x, area)
        Y = choose_nodes(roots, *x)
        assert residual(Y, x, f) <= 4e-14
        assert Y[[0, -1]] == pytest.approx([min(x[0][0], x[1][0]), max(x[0][-1], x[1][-1])], 1e-15)
        swapped = moment_roots(*x[::-1], area)
        assert np.array_equal(Y, choose_nodes(swapped, *x[::-1]))
        # Full rank on each side alone: never finer than the coarser one. And no coarser than it
        # but for a third.
        assert all(np.linalg.matrix_rank(hats(Y, p)) == len(Y) for p in x)
        assert len(Y) >= 0.6 * min(map(len, x))
        values = np.linalg.svd(np.vstack([hats(Y, p) for p in x]), compute_uv=False)
        assert values[-1] > 0.1 * values[0]
        # Any subset of the roots with both ends passes.
        inner = roots.points[1:-1][rng.random(len(roots.points) - 2) < 0.5]
        subset = np.concatenate([roots.points[:1], inner, roots.points[-1:]])
        near = np.diff(subset).min() / np.diff(subset).max()
        assert residual(subset, x, f) <= 4e-14 / min(1.0, near)


def test_formula():
    """s* of two overlapping facets that are wholly in contact."""
    x0, x1 = np.linspace(0.0, 1.0, 5), np.array([0.0, 0.3, 0.6, 0.9, 1.0])
    roots = moment_roots(x0, x1, (0.0, 1.0)).points
    known = [0.0, 1.0]
    for a, b in zip(x0[:-1], x0[1:], strict=True):
        for c, d in zip(x1[:-1], x1[1:], strict=True):
            if a + b != c + d:
                s = (a * b - c * d) / (a + b - c - d)
                if max(a, c) <= s <= min(b, d):
                    known.append(s)
    assert roots == pytest.approx(np.unique(np.round(known, 14)), abs=1e-14)


def test_matching_parts():
    """Where the meshes match the moment vanishes throughout, and the frame has their nodes."""
    same = np.linspace(0.0, 0.5, 6)
    x0, x1 = np.r_[same, 0.65, 0.8, 1.0], np.r_[same + 1e-17, 0.58, 0.7, 0.77, 1.0]
    roots = moment_roots(x0, x1, (0.0, 1.0))
    assert roots.intervals == pytest.approx(np.array([[0.0, 0.5]]), abs=1e-15)
    Y = choose_nodes(roots, x0, x1)
    assert Y[:5] == pytest.approx(same[:5], abs=1e-15)  # the last one borders on other cells
    # Given nodes inside the interval stay where they are.
    moved = nearest_nodes(np.array([0.1, 0.234, 0.41, 0.9]), roots)
    assert moved[[0, -1]] == pytest.approx([0.0, 1.0]) and moved[1:3] == pytest.approx(
        [0.234, 0.41]
    )
    x, f, _ = sides_in_contact(x0, x1)
    assert residual(Y, x, f) <= 1e-14 and residual(moved, x, f) <= 1e-14
    whole = choose_nodes(moment_roots(x0, x0, (0.0, 1.0)), x0, x0)
    assert np.array_equal(whole, x0)


def test_one_interval_and_too_many_nodes():
    x0, x1 = np.array([0.0, 2.0]), np.array([0.5, 3.0])  # one facet each, partly covered
    roots = moment_roots(x0, x1, (0.5, 2.0))
    Y = choose_nodes(roots, x0, x1)
    x, f, _ = sides_in_contact(x0, x1)
    assert Y.tolist() == [0.0, 3.0] and residual(Y, x, f) <= 1e-15
    with pytest.raises(ContactError, match="2 to"):
        nearest_nodes(np.linspace(0.0, 3.0, 9), roots)


def figures(contact):
    u, result = contact.solve(), contact.results[0]
    forces_ = [side.normal_force for side in result.sides]
    return u, result, patch2d.errors(u, forces_, [side.area for side in result.sides])


@pytest.mark.parametrize(
    ("kind", "separate"),
    [("quad", False), ("tri", True), longer("quad", True), longer("tri", False)],
)
def test_patch(kind, separate):
    scene = patch2d.bodies(MPI.COMM_SELF, kind, 1, separate)
    frames = []
    for design, order in (("positions", (0, 1)), ("positions", (1, 0)), ("auto", (0, 1))):
        _, result, found = figures(patch2d.problem(scene, design, order=order))
        assert max(found.values()) <= 1e-13
        assert result.certificate.residual <= 1e-14
        assert result.certificate.largest_correction == 0.0
        assert np.abs(result.frame.v - patch2d.exact(result.frame.x)).max() <= 1e-13 * 0.04
        frames.append(result.frame.x)
    assert all(np.array_equal(x, frames[0]) for x in frames)
    _, _, found = figures(patch2d.problem(scene, "weights"))
    assert max(found.values()) <= 1e-13
    _, result, found = figures(patch2d.problem(scene, None))
    assert result.certificate.residual > 1e-2 and found["stress"] > 1e-2


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_scaled_lengths(scale):
    scene = patch2d.bodies(MPI.COMM_SELF, "tri", 1, scale=scale)
    _, result, found = figures(patch2d.problem(scene))
    assert max(found.values()) <= 1e-13 and result.certificate.residual <= 1e-14


def test_given_frame():
    """Nodes go to the nearest roots; too many of them are refused."""
    scene = patch2d.bodies(MPI.COMM_SELF, "quad", 1)

    def frame(n):
        x = np.linspace(3.3, 1.0, n)  # turned the other way, too
        cells = np.column_stack([np.arange(n - 1), np.arange(1, n)])
        return Frame(np.column_stack([x, np.ones(n)]), cells)

    _, result, found = figures(patch2d.problem(scene, frame=frame(4)))
    assert max(found.values()) <= 1e-13 and len(result.frame.x) == 4
    with pytest.raises(ContactError, match="zeros"):
        patch2d.problem(scene, frame=frame(30))
    x, cells = frame(6).x, np.array([[0, 1], [2, 3], [4, 5]])
    with pytest.raises(ContactError, match="chain"):
        patch2d.problem(scene, frame=Frame(x, cells))


def test_pieces_are_refused():
    side = types.SimpleNamespace(
        x=np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]]),
        facets=np.array([[0, 1], [2, 3]]),
        name="tag 7",
    )
    plane = types.SimpleNamespace(project=lambda x: x[:, :1])
    with pytest.raises(ContactError, match="several pieces"):
        line._loaded_nodes(side, plane, (0.0, 3.0))


@pytest.mark.long
def test_two_ranks():
    one, two = (run_mpi_json("patch2d_ranks.py", n) for n in (1, 2))
    for name, found in one.items():
        assert np.array_equal(two[name].pop("frame"), found.pop("frame"))
        assert max(found.values()) <= 1e-13 and max(two[name].values()) <= 1e-13


def test_demo(tmp_path, capsys):
    rows = patch2d.main(["--json", str(tmp_path / "figures.json"), "--cells", "tri"])
    assert len(rows) == 5
    for name, row in rows.items():
        good = name in ("positions", "weights")
        assert (max(row.values()) <= 1e-13) == good
    assert "node-to-segment" in capsys.readouterr().out and (tmp_path / "figures.json").exists()
