"""What laws of one's own return wrongly: an error says what, and of which of their methods."""

import numpy as np
import pytest
from own_law import Column
from test_finite_laws import Columns

import dolfinx_llm as llm


class Layer(llm.Law):
    """Pressure in proportion to the overlap."""

    components, gives = "normal", True

    def force(self, nodes):
        k = 400.0 * nodes.area[:, None]
        return k * nodes.jump, k


def each(nodes, value=0.0):
    return {"a": np.full(len(nodes.x), value)}


def press(law, finite):
    """One load step of two columns."""
    if finite:
        columns = Columns("quad", law)
        columns.end.x.array[:] = -0.1
        columns.solve()
    else:
        Column(law).pull(-0.002)


# What is wrong: which method, what it returns, the text; the last two where steps end.
WRONG = [
    ("force", lambda n: None, "return two arrays"),
    ("force", lambda n: n.jump, "return two arrays"),
    ("force", lambda n: (n.jump[:, 0], n.area), r"forces of shape \(\d,\), not \(\d, 1\)"),
    ("force", lambda n: (n.jump[:2], n.jump), r"forces of shape \(2, 1\)"),
    ("force", lambda n: (n.jump, 400.0), r"derivative of shape \(\)"),
    ("force", lambda n: (n.jump, n.jump * 1j), "derivative of type complex"),
    ("force", lambda n: (n.jump, np.nan * n.jump), "derivative with . values that are not finite"),
    ("rows", lambda n: None, "status of type object"),
    ("start", lambda n: None, "return a dict"),
    ("start", lambda n: {"a": 0.0}, r"a of shape \(\)"),
    ("begin_step", lambda n: [1], "return a dict"),
    ("begin_step", lambda n: {"a": np.zeros(2)}, r"a of shape \(2,\)"),
    ("end_step", lambda n: None, "return a dict"),
    ("end_step", lambda n: {"a": np.zeros((2, 2))}, r"a of shape \(2, 2\)"),
]  # fmt: skip


@pytest.mark.parametrize("finite", [False, True], ids=["linear", "finite"])
@pytest.mark.parametrize(("method", "returned", "words"), WRONG)
def test_refused(finite, method, returned, words):
    law = type("Own", (Layer,), {method: lambda self, nodes: returned(nodes)})()
    with pytest.raises(llm.ContactError, match=f"{method} of the law Own.*{words}"):
        press(law, finite)


@pytest.mark.parametrize("finite", [False, True], ids=["linear", "finite"])
@pytest.mark.parametrize(
    ("ended", "words"),
    [
        (lambda n: {"b": np.zeros(len(n.x))}, "nothing for a"),
        (lambda n: {"a": np.zeros((len(n.x), 2))}, r"a of shape \(., 2\), \(.,\) before"),
    ],
)  # fmt: skip
def test_what_is_kept_stays_what_it_is(finite, ended, words):
    law = type(
        "Own", (Layer,), {"start": lambda _, n: each(n), "end_step": lambda _, n: ended(n)}
    )()
    with pytest.raises(llm.ContactInputError, match=f"end_step of the law Own.*{words}"):
        press(law, finite)


@pytest.mark.parametrize("method", ["miss", "strength", "at_stake"])
def test_values_at_nodes(method):
    for value, words in ((np.zeros(2), r"values of shape \(2,\)"), (None, "of type object")):
        law = type("Own", (Layer,), {method: lambda _, nodes, value=value: value})()
        with pytest.raises(llm.ContactInputError, match=f"{method} of the law Own.*{words}"):
            Column(law).pull(-0.002)


def test_a_law_that_ends_is_left_by_smaller_increments():
    """Values of an iterate that are not finite fail it, not the load step."""

    class Ends(Layer):
        def force(self, nodes):
            force, k = super().force(nodes)
            return np.where(nodes.jump > 0.3, np.nan, force), k

    columns = Columns("quad", Ends())
    columns.end.x.array[:] = -0.15
    columns.solve()
    with pytest.raises(llm.ContactError, match="forces with . values that are not finite"):
        columns.end.x.array[:] = -1.2
        columns.solve()
