"""The way along frames in the plane."""

import numpy as np

from dolfinx_llm.output.drawing import ways


def test_ways_follow_the_frame():
    """An arc whose nodes are numbered at random, of segments and of second order; a second piece
    goes on where the first ends; a closed one is gone round once."""
    rng, n = np.random.default_rng(5), 9
    angle, number = np.linspace(0.0, np.pi, n), rng.permutation(n)
    x = np.zeros((n + 2, 2))
    x[number] = np.column_stack([-np.cos(angle), -np.sin(angle)])
    x[n:] = [[5.0, 1.0], [5.0, 2.0]]
    segments = np.concatenate([np.column_stack([number[:-1], number[1:]]), [[n, n + 1]]])
    step = 2.0 * np.sin(np.pi / (n - 1) / 2.0)
    for cells in (segments, np.column_stack([number[:-2:2], number[2::2], number[1::2]])):
        (first, *_), s = ways(x[:n] if cells.shape[1] == 3 else x, cells)
        assert first.tolist() == number.tolist()
        assert np.allclose(s[number], step * np.arange(n), rtol=0.0, atol=1e-12)
    pieces, s = ways(x, segments)
    assert len(pieces) == 2 and np.isclose(s[n + 1] - s[n], 1.0)
    ring = np.column_stack([number, np.roll(number, -1)])
    (order,), s = ways(x[:n], ring)
    assert np.isclose(s.max(), step * (n - 1)) or np.isclose(s.max(), step * (n - 2) + 2.0)
