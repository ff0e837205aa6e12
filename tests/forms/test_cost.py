"""The estimate by which ``solver="auto"`` chooses: what it counts, and that nothing else counts."""

from dataclasses import replace

import cost_scenes
import pytest
from conftest import run_mpi_json
from mpi4py import MPI
from sampling import longer

from dolfinx_llm.forms import choice
from dolfinx_llm.forms.cost import ELIMINATED, ENTRIES, Scene, costs, entries
from dolfinx_llm.forms.direct import DirectSolver

COMM = MPI.COMM_SELF
BLOCKS = Scene(
    dim=3, order=1, bodies=(10_000, 22_000), rows=1200, frame=1000, motions=0, parted=0,
    opens=True, slips=True,
)  # fmt: skip
LAWS = {"tied": (False, False), "frictionless": (True, False), "friction": (True, True)}


def refined(k, law, dim=3):
    """The blocks with k cells a side in the place of 10."""
    opens, slips = LAWS[law]
    rows, times = (dim if slips or not opens else 1) * 170 * (k / 10.0) ** (dim - 1), k / 10.0
    return replace(
        BLOCKS, dim=dim, opens=opens, slips=slips, rows=int(rows), frame=int(rows / 2),
        bodies=tuple(int(n * times**dim) for n in (3500, 7000)),
    )  # fmt: skip


def least(scene):
    found = costs(scene)
    return min(found, key=lambda name: found[name].seconds)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", LAWS)
def test_grows_with_what_there_is(law, dim):
    """Work and memory of every form; from some size on multigrid is least, and stays so."""
    scenes = [refined(k, law, dim) for k in range(8, 60, 2)]
    for one, other in zip(scenes, scenes[1:]):
        for name, cost in costs(other).items():
            before = costs(one)[name]
            assert cost.seconds > before.seconds and cost.gigabytes > before.gigabytes
    forms = [least(scene) for scene in scenes]
    assert forms == sorted(forms, key="condensed".__eq__)
    if dim == 3:
        assert forms[0] != "condensed" == forms[-1]


@pytest.mark.parametrize(
    ("change", "forms"),
    [
        ({"rows": 1400}, {"flexibility", "saddle"}),
        ({"motions": 40}, {"flexibility"}),
        ({"order": 2}, {"condensed"}),
        ({"parted": 50}, {"saddle", "condensed"}),
        ({"bodies": (32_000,)}, {"flexibility", "saddle"}),
        ({"slips": False}, set()),
    ],
)
def test_counts(change, forms):
    """What makes a form dearer leaves the others as they are."""
    before, after = costs(BLOCKS), costs(replace(BLOCKS, **change))
    dearer = {name for name in before if after[name].seconds > before[name].seconds}
    assert dearer == forms
    if change == {"slips": False}:
        assert all(after[name].seconds < before[name].seconds for name in before)


def test_ranks_share_all_but_what_is_dense():
    two = costs(replace(BLOCKS, ranks=2))
    for name, cost in costs(BLOCKS).items():
        share = two[name].seconds / cost.seconds
        assert 0.5 < share < 1.0 if name == "flexibility" else share == 0.5


@pytest.mark.parametrize(
    ("dim", "n", "cell"),
    [(2, 40, "quadrilateral"), (3, 8, "hexahedron"), longer(2, 120, "triangle"),
     longer(3, 16, "hexahedron"), longer(3, 16, "tetrahedron")],
)  # fmt: skip
def test_entries_are_those_of_mumps(dim, n, cell):
    """Of the factor of two blocks."""
    problem = cost_scenes.blocks(COMM, dim, n, cell)
    solver = DirectSolver(problem.K, "counted_")
    made = solver.ksp.getPC().getFactorMatrix().getMumpsInfog(29)
    made = -1e6 * made if made < 0 else made
    told = sum(entries(size, dim) for size in Scene.of(problem.operators).bodies)
    assert 0.6 <= told / made <= 1.7, (told, made, ENTRIES[dim])
    if dim == 3:
        made = solver.ksp.getPC().getFactorMatrix().getMumpsRinfog(3)
        told = sum(ELIMINATED * float(size) ** 2 for size in Scene.of(problem.operators).bodies)
        assert 0.4 <= told / made <= 2.5, (told, made)
    solver.destroy()


def test_printed(monkeypatch):
    """Work and memory of every form, the one that is taken, and why; and what does not serve."""
    problem = cost_scenes.blocks(COMM, 3, 4, "hexahedron")
    told = str(problem)
    found = costs(Scene.of(problem.operators))
    assert problem.form == least(Scene.of(problem.operators))
    assert all(f"{name} {cost}" in told for name, cost in found.items())
    assert "chosen: least work, about, in 4 load steps on 1 rank(s): " in told
    loose = [cost_scenes.blocks(COMM, 3, 4, "hexahedron", held=False)]
    monkeypatch.setattr(choice, "ONE_BODY", 5)
    loose = [*map(str, loose), str(cost_scenes.blocks(COMM, 3, 4, "hexahedron", held=False))]
    assert "no multigrid" not in loose[0] and "condensed 0" in loose[0]
    assert "no multigrid: contact alone holds" in loose[1] and "condensed 0" not in loose[1]


def test_memory(monkeypatch):
    """What does not fit is left out, as long as something is left."""
    found = costs(Scene.of(cost_scenes.blocks(COMM, 3, 8, "hexahedron").operators))
    fitting = min(found, key=lambda name: found[name].gigabytes)
    monkeypatch.setattr(choice, "_memory", lambda: found[fitting].gigabytes)
    problem = cost_scenes.blocks(COMM, 3, 8, "hexahedron")
    assert problem.form == fitting and "what fits into memory" in str(problem)
    monkeypatch.setattr(choice, "_memory", lambda: 0.0)
    assert cost_scenes.blocks(COMM, 3, 8, "hexahedron").form == min(
        found, key=lambda name: found[name].seconds
    )


def test_the_same_on_all_ranks():
    alone = cost_scenes.chosen(COMM)
    for found in run_mpi_json("cost_scenes.py", 2)["ranks"]:
        assert found["scenes"] == alone["scenes"]
        assert found["forms"] == alone["forms"]


def test_many_steps_favour_what_is_kept():
    """A thousand steps in time: back-substitutions against solves by multigrid."""
    few, many = costs(BLOCKS), costs(replace(BLOCKS, steps=1000))
    assert min(few, key=lambda name: few[name].seconds) == "condensed"
    assert min(many, key=lambda name: many[name].seconds) == "flexibility"
    assert all(many[name].gigabytes == few[name].gigabytes for name in few)
