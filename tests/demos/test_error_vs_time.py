"""Error against run time: errors of all methods against theory, and what is made of the rows."""

import contextlib
import io
import json

import error_vs_time
import numpy as np
import pytest
from mpi4py import MPI
from sampling import longer
from work_precision import evaluation, methods, plan

needs_mpc = pytest.mark.skipif(methods.dolfinx_mpc is None, reason="dolfinx_mpc is not installed")


def solve(*case):
    return methods.solve(MPI.COMM_SELF, *case)


@pytest.mark.parametrize("solver", [plan.SADDLE, plan.CHOLESKY, plan.GAMG])
def test_designed_frames_and_one_mesh_pass_the_patch_test(solver):
    assert solve("patch test", plan.WEIGHTS, solver, 1)["von_mises"] <= 1e-12
    if solver != plan.SADDLE:
        assert solve("patch test", plan.MATCHING, solver, 1)["von_mises"] <= 1e-11


@pytest.mark.parametrize(
    "method",
    [
        plan.UNDESIGNED,
        f"{plan.NODE_TO_SEGMENT}, slave 0",
        longer(f"{plan.NODE_TO_SEGMENT}, slave 1"),
    ],
)
def test_others_fail_the_patch_test_and_refinement_does_not_help(method):
    coarse, fine = (solve("patch test", method, plan.SADDLE, n)["von_mises"] for n in (1, 2))
    assert min(coarse, fine) >= 0.05


@pytest.mark.long  # of frames and the matching mesh: test_demos.test_convergence
def test_rates_of_the_manufactured_field():
    """Displacement of second order for all; pressure of first order with frames, of an undesigned
    one in the mean of both sides' areas."""
    rows = {
        method: [solve("manufactured", method, solver, n) for n in (4, 8)]
        for method, solver in (
            (plan.WEIGHTS, plan.GAMG), (plan.MATCHING, plan.CHOLESKY),
            (plan.UNDESIGNED, plan.SADDLE),
            *((f"{plan.NODE_TO_SEGMENT}, slave {k}", plan.SADDLE) for k in (0, 1)),
        )
    }  # fmt: skip

    def rate(method, key):
        coarse, fine = rows[method]
        return np.log2(coarse[key] / fine[key])

    for method in (plan.WEIGHTS, plan.MATCHING):
        assert rate(method, "l2") >= 1.9 and rate(method, "h1") >= 0.95
    assert rate(plan.WEIGHTS, "pressure") >= 1.0
    for method in (f"{plan.NODE_TO_SEGMENT}, slave {k}" for k in (0, 1)):
        assert rate(method, "pressure") <= 0.7
    # The predicted frame is side 0's own surface: undesigned, it ties side 1 to that, no more.
    tied = rows[f"{plan.NODE_TO_SEGMENT}, slave 1"]
    for a, b in zip(rows[plan.UNDESIGNED], tied):
        assert abs(a["l2"] / b["l2"] - 1.0) <= 1e-8


@needs_mpc
@pytest.mark.parametrize("slave", [0, 1])
def test_dolfinx_mpc_ties_as_node_to_segment(slave):
    segment = solve("manufactured", f"{plan.NODE_TO_SEGMENT}, slave {slave}", plan.SADDLE, 4)
    for solver in (plan.CHOLESKY, plan.GAMG):
        row = solve("manufactured", f"{plan.MPC} tied, slave {slave}", solver, 4)
        assert abs(row["h1"] / segment["h1"] - 1.0) <= 1e-8


@needs_mpc
def test_dolfinx_mpc_that_slips_fails_the_patch_test():
    assert solve("patch test", f"{plan.MPC} slip, slave 1", plan.CHOLESKY, 1)["von_mises"] >= 0.05


@pytest.mark.long
@pytest.mark.parametrize("solver", [plan.SADDLE, plan.CHOLESKY])
def test_hertz(solver):
    """A designed frame's pressure converges, an undesigned one's does not."""
    coarse, fine = (solve("Hertz", plan.POSITIONS, solver, n) for n in (8, 16))
    assert fine["pressure"] <= 0.5 * coarse["pressure"] and fine["peak"] <= 0.003
    coarse, fine = (solve("Hertz", plan.UNDESIGNED, plan.SADDLE, n) for n in (8, 16))
    assert fine["pressure"] >= 0.9 * coarse["pressure"]


@pytest.mark.parametrize(
    ("scene", "error", "n", "most"),
    [("dragged block", "friction", 4, 1e-11), longer("dragged block", "friction", 6, 1e-11),
     longer("Hertz 3D", "pressure", 6, 3e-3), longer("Cattaneo-Mindlin", "traction", 16, 0.05)],
)  # fmt: skip
def test_opening_and_friction(scene, error, n, most):
    """The known answers, whichever way; a linear solve of the matching mesh has none to show."""
    rows = [solve(scene, *case, n) for case in plan.CASES[scene]]
    laws = [row for row in rows if row["method"] == plan.LAW]
    assert len(laws) == 3 and all(row[error] <= most for row in laws)
    assert all(error not in row for row in rows if row["method"] == plan.MATCHING)
    assert laws[-1]["form"] == "condensed" and len({row["form"] for row in laws}) > 1


def test_sizes():
    """More of them where they are asked for, but for what is factorised."""
    few = plan.SIZES["dragged block"]
    assert plan.sizes_of("dragged block", plan.LAW, plan.CHOSEN, False) == few
    assert plan.sizes_of("dragged block", plan.LAW, plan.CHOSEN, False, 100_000) == (*few, 20)
    assert plan.sizes_of("dragged block", plan.LAW, plan.SADDLE, False, 400_000) == few


def run_here(scene, cases, ranks):
    """In the place of a process of its own."""
    with contextlib.redirect_stdout(io.StringIO()) as said:
        methods.run(scene, cases)
    about, *rows = map(json.loads, said.getvalue().splitlines())
    return about["about"], rows


@pytest.mark.parametrize("every", [False, longer(True)])
def test_quick_form(every, tmp_path, capsys, monkeypatch):
    """Table, files and picture; every figure of the run is in them."""
    monkeypatch.setitem(plan.QUICK, "Hertz", (8,))
    if not every:
        monkeypatch.setitem(plan.CASES, "Hertz", plan.CASES["Hertz"][::5])
        monkeypatch.setattr(methods, "SHORT", 0.0)
        monkeypatch.setattr(error_vs_time, "run", run_here)
    rows = error_vs_time.main(["--quick", "--scenes", "Hertz", "--output", str(tmp_path)])
    out = capsys.readouterr().out
    cases = {(row["method"], row["solver"], row["n"]) for row in rows}
    assert cases == {(*case, n) for case in plan.CASES["Hertz"] for n in plan.QUICK["Hertz"]}
    assert all(f"{row['pressure']:.1e}" in out for row in rows)
    for row in rows:
        stages = sum(row[stage] for stage in plan.STAGES)
        assert abs(stages - row["mesh"] - row["seconds"]) < 1e-9 and stages <= row["wall"]
    report = json.loads((tmp_path / "error_vs_time.json").read_text())
    assert report["rows"] == rows and report["about"]["ranks"] == 1
    header, *lines = (tmp_path / "error_vs_time.csv").read_text().splitlines()
    assert {"memory", "cpu", *plan.STAGES} <= set(header.split(",")) and len(lines) == len(rows)
    assert (tmp_path / "error_vs_time.png").read_bytes()[:4] == b"\x89PNG"
    file = str(tmp_path / "error_vs_time.json")
    again = ["--read", file, "--against", file, "--scenes", "Hertz", "--output", str(tmp_path)]
    monkeypatch.setattr(evaluation, "diagrams", lambda *_: None)
    assert error_vs_time.main(again) == rows
    assert f"of {len(plan.CASES['Hertz']) - 1} within 15 %, median 0 %" in capsys.readouterr().out


def row(method, n, seconds, error, solver=plan.SADDLE):
    return {"scene": "manufactured", "method": method, "solver": solver, "n": n,
            "cpu_seconds": seconds, "l2": error}  # fmt: skip


def test_time_to_an_error():
    """Between two sizes in logarithms; none where a method does not get there."""
    line = [row(plan.WEIGHTS, 4, 1.0, 1e-2), row(plan.WEIGHTS, 8, 100.0, 1e-4)]
    for goal, seconds in ((1e-1, 1.0), (1e-2, 1.0), (1e-3, 10.0), (1e-4, 100.0), (1e-5, np.inf)):
        assert np.isclose(evaluation.time_to(goal, line, "l2"), seconds, rtol=1e-12)
    rival = f"{plan.NODE_TO_SEGMENT}, slave 0"
    found = evaluation.against_rivals([*line, row(rival, 4, 5.0, 1e-3)], "manufactured", "l2")
    assert np.allclose(found[rival, plan.SADDLE], [2.0])


def test_comparison_of_two_runs():
    """A machine that is twice as slow changes nothing; one method that is, does."""
    first = [row(m, n, t, 0.1, solver) for n in (4, 8)
             for m, t, solver in ((plan.MATCHING, 0.5, plan.GAMG), (plan.WEIGHTS, 1.0, plan.SADDLE),
                                  (plan.WEIGHTS, 2.0, plan.GAMG))]  # fmt: skip
    slower = [{**r, "cpu_seconds": 2.0 * r["cpu_seconds"]} for r in first]
    one = [*(dict(r) for r in first[:5]), dict(slower[5])]
    for rows in (first, slower, one):
        evaluation.add_ratios(rows)
    assert [r["ratio"] for r in first] == [1.0, 2.0, 4.0] * 2
    every, finest = evaluation.compare(slower, first).splitlines()[1:]
    assert "4 of 4 within 15 %, median 0 %, largest 0 %" in every
    every, finest, case = evaluation.compare(one, first).splitlines()[1:]
    assert "3 of 4 within 15 %" in every and "largest 100 %" in every and plan.GAMG in every
    assert "1 of 2 within 15 %, median 50 %" in finest
    assert case.split()[:3] == ["4.00", "->", "8.00"] and case.endswith(
        f"{plan.WEIGHTS}, {plan.GAMG}, 8"
    )


def test_median_run():
    rows = [{"cpu_seconds": t, "wall": w} for t, w in ((3.0, 1), (1.0, 2), (2.5, 3), (9.0, 4))]
    assert evaluation.median_run(rows[:3]) is rows[2] is evaluation.median_run(rows)
    failed = [{"failed": "why"}] * 3
    assert evaluation.median_run(failed) == failed[0]
