"""The demos as users run them: their figures, files and pictures."""

import json
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from conftest import TESTS, clean_environment, run_mpi, run_mpi_json
from sampling import longer

import dolfinx_llm as llm

DEMOS = TESTS.parent / "demos"


@pytest.mark.parametrize("frame", ["predicted", longer("optimised")])
def test_patch3d_on_two_ranks(frame, tmp_path):
    """Tables, JSON, pictures and files for ParaView of the 3D patch test."""
    report, drawn = tmp_path / "report.json", frame == "optimised"
    files = "--output", tmp_path / "out", *(("--plot", tmp_path) if drawn else ())
    out = run_mpi(DEMOS / "patch3d.py", 2, "--frame", frame, "--json", report, *files)
    for words in ("Table 2", "Table 3", "Table 4", "Table 5", "node to segment", "left out"):
        assert words in out
    figures = json.loads(report.read_text())
    assert figures["ranks"] == 2
    assert max(figures["errors"].values()) <= 1e-12
    assert figures["frame"]["residual"] <= 1e-13
    assert 25 <= figures["frame"]["min_angle"] <= figures["frame"]["max_angle"] <= 155
    for name in ("frame.png", "von_mises.png", "displacement.png") if drawn else ():
        assert (tmp_path / name).read_bytes()[:4] == b"\x89PNG"
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"bodies.pvd", "bodies_0_0.vtu", "frame.vtu", "side_0.vtu", "table_3.csv"} <= written
    table = np.genfromtxt(tmp_path / "out" / "side_1.csv", delimiter=",", names=True)
    assert abs(table["normal_force"].sum() - 789.668405) < 1e-6


@pytest.mark.long  # one field, with the same rates, is among README's figures
@pytest.mark.parametrize("field", ["manufactured", "bending"])
def test_convergence(field):
    """Rates on non-matching cubes, and no loss against the matching mesh of the coarser kind."""
    import convergence

    first, second = convergence.main(["--field", field, "--refinements", "3"])[-2:]
    for key, least in (("l2", 1.95), ("h1", 0.98), ("pressure", 1.0)):
        assert np.log2(first["tied"][key] / second["tied"][key]) >= least, key
    for key in ("l2", "h1"):
        assert second["tied"][key] <= 1.2 * second["matching"][key]


@pytest.mark.parametrize("largest", [1_100, longer(10_000)])
def test_scale(largest):
    """Design by weights passes; what is measured is what an interface calls."""
    import scale

    rows = scale.main(["--largest", str(largest)])
    assert rows[-1]["nodes"][1] > largest
    assert all(row["residual"] <= 1e-13 for row in rows)


@pytest.mark.long
def test_solvers(tmp_path, monkeypatch, capsys):
    """Iterations of the condensed form against the matching mesh's; a case in its own process."""
    import solvers

    def run(method, n, ranks, alone=solvers.run):
        if method == "saddle":
            return alone(method, n, ranks)
        capsys.readouterr()
        solvers.case(method, n)
        return json.loads(capsys.readouterr().out.splitlines()[-1])

    monkeypatch.setattr(solvers, "run", run)
    report, files = tmp_path / "report.json", ["--plot", str(tmp_path)]
    solvers.main(["--largest", "8500", "--repeat", "1", "--json", str(report), *files])
    out = capsys.readouterr().out
    rows = {row["method"]: row for row in json.loads(report.read_text())}
    assert len(rows) == 6 and all(name in out for name in rows)
    assert (tmp_path / "solvers.png").read_bytes()[:4] == b"\x89PNG"
    tied, matching = (rows[f"{kind} CG + GAMG"]["iterations"] for kind in ("condensed", "matching"))
    frictionless = rows["frictionless CG + GAMG"]["iterations"]
    assert 0 < tied <= 1.3 * matching
    # All solves of a load step: by PETSc's version 2.1 to 3.6 times, as sliding between the bodies
    # is missing on coarse levels.
    assert 0 < frictionless <= 3.6 * matching
    assert 0 < rows["friction GMRES + GAMG"]["iterations"] <= 3.0 * matching
    assert max(row["residual"] for row in rows.values()) <= 1e-12


def test_stiff_cases(capsys):
    """The table says of every case how it went, and none is wrong in silence."""
    import stiff_cases

    rows = stiff_cases.main(["--size", "4", "--only", "E ratio"])
    assert len(rows) == 2 * 6
    assert {row["verdict"] for row in rows} == {"passed", "warned of"}
    assert "by rounding alone" in capsys.readouterr().out


@pytest.mark.parametrize("ranks", [1, longer(2)])
def test_tutorial(ranks, tmp_path):
    """Forces and friction against theory, pictures and files; the same on two ranks."""
    import tutorial

    assert len((DEMOS / "tutorial.py").read_text().splitlines()) < 80
    result, shares = tutorial.main(tmp_path)
    assert abs(result.resultant[2] + tutorial.PRESSURE) <= 1e-9
    # Just short of gross slip, where frame nodes at the rim may slip either way.
    assert np.all(np.diff(shares) > 0.0) and shares[-2] < 0.9 and 0.98 < shares[-1] <= 1.0 + 1e-9
    for name in ("bodies.png", "interface_0.png"):
        assert (tmp_path / name).read_bytes()[:4] == b"\x89PNG"
    written = {path.name for path in tmp_path.iterdir()}
    assert {"bodies.pvd", "bodies_0_0.vtu", "frame.vtu", "side_0.vtu", "side_1.csv"} <= written
    if ranks == 2:
        found = run_mpi_json("tutorial_ranks.py", ranks, tmp_path / "ranks")
        np.testing.assert_allclose(found["shares"], shares, atol=1e-9)
        np.testing.assert_allclose(found["force"], result.resultant, atol=1e-9)
        np.testing.assert_allclose(found["pressure"], result.pressure, atol=1e-7)


def test_ironing(tmp_path, capsys):
    """Friction on the die while it is drawn along, and pictures."""
    import ironing

    report = ironing.main(["--mu", "0.3", "--down", "1", "--steps", "2", "--plot", str(tmp_path)])
    found = report[0.3]
    along, normal = -found["force"][:, 0], found["force"][:, 1]
    assert found["halvings"] == 0 and max(found["iterations"]) <= 8
    assert 0.0 < found["slip"][-1]
    assert (0.2 * normal < along).all() and (along < 0.34 * normal).all()
    assert (tmp_path / "ironing_2d.png").read_bytes()[:4] == b"\x89PNG"
    assert "halvings 0" in capsys.readouterr().out


@pytest.mark.long
@pytest.mark.parametrize("mu", [0.0, 0.3])
def test_ironing_in_space(mu):
    """Travel of half a facet a step: no halving, and without friction no trace of the facets."""
    import ironing

    found = ironing.main(["--dim", "3", "--mu", str(mu), "--steps", "8"])[mu]
    assert found["halvings"] == 0 and max(found["iterations"]) <= (12 if mu else 8)
    if not mu:
        assert (found["ripple"] < 3e-3).all()


@pytest.mark.long
def test_edge_along_nodes(monkeypatch):
    """The die's edges lie on nodes of the slab, which come in and go out as it is squeezed."""
    import ironing

    slab, (corner, size, cells) = ironing.BOXES[3]
    die = (corner[0], 0.2, corner[2]), (size[0], 0.6, size[2]), cells
    monkeypatch.setitem(ironing.BOXES, 3, (slab, die))
    run = ironing.Ironing(0.0, 3)
    done = [run.step(0.0, ironing.DEPTH * k / 4) for k in (1, 2, 3)]
    assert all(halvings == 0 for _, _, halvings, _ in done)
    force, side = done[-1][0], run.problem.results[0].sides
    assert np.abs(side[0].force.sum(axis=0) + side[1].force.sum(axis=0)).max() < 1e-10 * force[2]
    # What goes in and out on one edge does on the other: forces are even across the die.
    across, load = side[1].x[:, 1], side[1].force[:, 2]
    assert abs(load @ (across - 0.5)) < 1e-8 * np.abs(load).sum()


@pytest.mark.long
def test_turned_strips(monkeypatch, capsys):
    """No friction and no slip by turning."""
    import turned_strips

    monkeypatch.setattr(turned_strips, "LAWS", (llm.Coulomb(0.1),))
    a_little = partial(turned_strips.to_and_fro, steps=1, degrees=20.0)
    monkeypatch.setattr(turned_strips, "to_and_fro", a_little)
    report = turned_strips.main(["--turn", "20", "--step", "20"])
    (found,) = (report[key] for key in report if key != "to and fro")
    assert found["change"] < 1e-10 and found["slip"] < 1e-10 and min(found["pairs"]) > 0
    assert report["to and fro"] < 1e-10
    assert "to and fro" in capsys.readouterr().out


@pytest.mark.long
def test_second_order(tmp_path):
    """Rates of stresses, and less error than of first order with fewer unknowns; a picture."""
    import second_order

    sizes = ["--cells", "8", "16", "--elements", "4"]
    rows = second_order.main([*sizes, "--plot", str(tmp_path)])
    (one, half, two, quarter), opening = rows[:4], rows[4:]
    assert np.log2(one["error"] / half["error"]) >= 0.98
    assert np.log2(two["error"] / quarter["error"]) >= 1.95
    assert two["unknowns"] <= half["unknowns"] and two["error"] < 0.1 * half["error"]
    assert opening[1]["error"] < 0.5 * opening[0]["error"]
    assert (tmp_path / "second_order.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.long
@pytest.mark.parametrize("nu", [0.4999, 0.5])
def test_incompressible(nu, tmp_path):
    """Plain elements lock, those of (u, p) do not; a picture."""
    import incompressible

    arguments = ["--nu", str(nu), "--elements", "4", "8", "--plot", str(tmp_path)]
    rows = incompressible.main(arguments)
    error = {(row["method"], row["n"]): row["error"] for row in rows}
    assert 0.0 < error["(u, p)", 8] < 0.5 * error["(u, p)", 4] < 0.005
    if nu < 0.5:
        assert error["Q1", 8] > 1.0 and error["Q2", 8] > 5.0 * error["(u, p)", 8]
    assert (tmp_path / "incompressible.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.long
def test_shrink_fit_cooling(tmp_path):
    """Open at first; then pressure and heat of the closed form, and none of the heat is lost."""
    import shrink_fit_cooling as cooling

    files = "--json", tmp_path / "rows.json", "--plot", tmp_path
    first, *rows = cooling.main([*map(str, files)])
    assert first["pressure"] == 0.0 == first["closed form"]["pressure"]
    assert abs(first["flow"]) < 1e-12
    for row in rows:
        for name in ("pressure", "flow"):
            assert row[name] == pytest.approx(row["closed form"][name], rel=5e-3)
        assert row["uneven"] < 0.06 * row["pressure"]
        assert abs(row["left"]) < 1e-12 * row["flow"]
    assert (tmp_path / "shrink_fit_cooling.png").read_bytes()[:4] == b"\x89PNG"
    assert len(json.loads((tmp_path / "rows.json").read_text())) == 4


@pytest.mark.long
@pytest.mark.parametrize(("mu", "solver"), [(0.3, "auto"), (0.3, "condensed"), (0.2, "saddle")])
def test_adjoint(tmp_path, mu, solver):
    """Derivatives by moduli and load against differences, where nodes stick and slip."""
    import adjoint

    files = "--json", tmp_path / "rows.json", "--plot", tmp_path
    chosen = "--mu", mu, "--solver", solver, "--elements", 6, 7
    found = adjoint.main([*map(str, (*files, *chosen))])
    assert found["stick"] and found["slip"]
    for name, told, differences in found["rows"]:
        assert told == pytest.approx(differences, rel=1e-6), name
    assert (tmp_path / "adjoint.png").read_bytes()[:4] == b"\x89PNG"
    assert len(json.loads((tmp_path / "rows.json").read_text())["rows"]) == 5


@pytest.mark.parametrize(
    ("name", "forces"),
    [longer("oring", None), longer("lug", None), longer("assembly", [[4.0, 0.0, -40.0]] * 2)],
)
def test_first_scripts(name, forces, tmp_path):
    """Scripts as new users write them run as they are, show bodies with pressure, and balance."""
    script = TESTS / "demos" / "first_scripts" / f"{name}.py"
    assert len(script.read_text().splitlines()) <= 70
    out = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, env=clean_environment(), timeout=300,
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    found = np.array(json.loads(out.splitlines()[-1]))
    if name == "lug":  # what pulls the pin; what holds its ends takes friction's part across
        assert found[1, 0] == pytest.approx(found[0, 0], rel=1e-9)
        assert np.abs(found[1, 1:]).max() < 0.01 * found[0, 0]
    elif forces is None:  # the ring has no load of its own
        np.testing.assert_allclose(found[0], -found[1], atol=1e-9 * np.abs(found).max())
        assert np.abs(found[:, 1]).min() > 100 * np.abs(found[:, 0]).max()
        assert (tmp_path / "out" / "squeeze.gif").stat().st_size > 10_000
    else:
        np.testing.assert_allclose(np.abs(found), np.abs(forces), atol=1e-9)
    assert (tmp_path / "out" / "bodies.png").read_bytes()[:4] == b"\x89PNG"
    assert list((tmp_path / "out").glob("bodies*.pvd"))


@pytest.mark.long
def test_periodic_cell(tmp_path):
    """Conductivity of the series, and none but the mean gradient without fibre."""
    import periodic_cell

    files = "--json", tmp_path / "rows.json", "--plot", tmp_path
    rows = periodic_cell.main(["--refine", "1", *map(str, files)])
    for row in rows:
        assert row["k"] == pytest.approx(row["series"], rel=5e-3)
        assert np.abs(row["no fibre"]).max() < 1e-13
    assert (tmp_path / "periodic_cell.png").read_bytes()[:4] == b"\x89PNG"
    assert len(json.loads((tmp_path / "rows.json").read_text())) == 3
