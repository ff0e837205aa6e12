"""Pictures and files: what they hold is read back. PyVista may be missing, broken, or hang."""

import io
import itertools
import json
import logging
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from base64 import b64decode
from dataclasses import replace

import finite_patch
import mixed
import numpy as np
import pairs
import patch3d
import pytest
import scenes
import ufl
from conftest import run_mpi_json
from contact_scenes import Pressed, rectangle
from dolfinx import fem, mesh
from dolfinx.common import has_adios2
from matplotlib import colors
from mpi4py import MPI
from paper_data import scene as patch_scene
from scipy.spatial import cKDTree as tree

import dolfinx_llm as llm
from dolfinx_llm import compat, plot, post
from dolfinx_llm.contact.results.results import InterfaceResult
from dolfinx_llm.geometry.cells import vector_areas
from dolfinx_llm.output import bodies, drawing, render

COMM = MPI.COMM_SELF


@pytest.fixture(scope="module")
def patch():
    """The 3D patch test, solved: its displacement and its problem."""
    domain, tags = patch_scene(COMM)
    problem = patch3d.problem(compat.function_space(domain, shape=(3,)), tags, "predicted")
    return problem.solve(), problem


def pressed():
    """Two rectangles that part and slide; solved once."""
    low = rectangle(COMM, (4, 2), (-1.0, 0.0), (1.0, 1.0), "quadrilateral")
    high = rectangle(COMM, (5, 2), (-0.5, 1.0), (0.5, 2.0), "triangle")
    scene = Pressed([low, high], llm.Coulomb(0.3), lambda p: p[1] > 1.99, lambda p: p[1] < 0.01)
    push(scene, 0.01)
    return scene


def push(scene, by):
    scene.move(lambda p: np.stack([0.5 * by + 0 * p[0], -by + 0.01 * p[0], 0 * p[0]]))


def image(path):
    from matplotlib.image import imread

    return imread(path)[..., :3]


# ## Pictures
@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """Puts a PyVista of the given text in the place of another, or of none."""

    def put(text):
        (tmp_path / "stand_in").mkdir()
        (tmp_path / "stand_in" / "pyvista.py").write_text(text)
        monkeypatch.syspath_prepend(tmp_path / "stand_in")
        monkeypatch.setenv("PYTHONPATH", str(tmp_path / "stand_in"))
        monkeypatch.setattr(render, "_failed", False)

    return put


@pytest.mark.parametrize(
    ("text", "seconds", "told"),
    [
        ("import os\nos.abort()", render.SECONDS, "exit code -6"),
        ("import time\ntime.sleep(60)", 0.3, "timed out"),
        ("raise ImportError('no libGL')", render.SECONDS, "no libGL"),
    ],
    ids=["aborts", "hangs", "raises"],
)
def test_broken_pyvista(stand_in, text, seconds, told, patch, tmp_path, monkeypatch, caplog):
    """Matplotlib draws instead, which is told once; PyVista is not asked a second time."""
    stand_in(text)
    monkeypatch.setattr(render, "SECONDS", seconds)
    with caplog.at_level(logging.WARNING, "dolfinx_llm"):
        patch[1].plot(tmp_path)
    assert [told in record.getMessage() for record in caplog.records] == [True]
    for name in ("bodies.png", "interface_0.png"):
        assert np.ptp(image(tmp_path / name)) > 0.9


def test_without_pyvista(patch, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(render, "find_spec", lambda name: None)
    patch[1].plot(tmp_path, "traction")
    assert (tmp_path / "bodies.png").exists() and (tmp_path / "interface_0.png").exists()
    assert not caplog.records


def test_process_that_draws_has_no_dolfinx():
    """Beside its libraries VTK 9.7 aborted: all pictures were Matplotlib's, and tests skipped."""
    text = "import runpy, sys; runpy.run_path(sys.argv[1]); print(*sys.modules)"
    command = [sys.executable, "-P", "-c", text, render.__file__]
    loaded = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert "numpy" in loaded
    assert not {"dolfinx_llm", "dolfinx", "petsc4py", "mpi4py"} & set(loaded)


def test_pyvista(tmp_path, monkeypatch):
    """A square seen along its normal: its colour is its value's, marks lie at its corners."""
    pytest.importorskip("pyvista")
    from matplotlib import colormaps

    monkeypatch.setattr(render, "_failed", False)
    x = np.array([[0.0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]])
    cells, status = np.array([[0, 1, 2, 3]]), np.array([0, 1, 2, 2])
    normal = np.array([1.0, 0.0, 0.0])
    values = np.full(4, 3.0)
    scene = render.Scene(x, cells, values, (0.0, 4.0), "|p| ×", normal, status)
    if not render.draw(scene, tmp_path / "square.png"):
        pytest.skip("PyVista is here, but cannot draw")
    picture = image(tmp_path / "square.png")
    assert picture.shape == (*render.PIXELS[::-1], 3)
    colour = np.array(colormaps["viridis"](0.75)[:3])
    square = np.abs(picture - colour).max(axis=2) < 0.02
    assert square[450, 800] and 0.2 < square.mean() < 0.6
    red = np.abs(picture - [1.0, 0.0, 0.0]).max(axis=2) < 0.3
    rows, columns = np.nonzero(red[:, :1300])  # without the legend
    assert rows.size and rows.max() < 450  # both at z = 1, z points up
    assert columns.min() < 800 < columns.max()


EXPORTS = """
class PolyData:
    def __init__(self, *args, **more): pass
class Plotter:
    def __init__(self, **more): self.camera = self
    def __getattr__(self, name): return lambda *args, **more: None
    def export_html(self, path): open(path, "w").write("<p>a page</p>")
"""


def pages(path):
    """Labels and pages of a film for browsers."""
    steps = json.loads(re.search(r"const steps = (.*), slider", path.read_text())[1])
    return [(label, b64decode(page).decode()) for label, page in steps]


def test_film_for_browsers(stand_in, patch, tmp_path, monkeypatch):
    """A page of one page per step; errors where nothing can export it, and in 2D."""
    from dolfinx_llm.output import film

    stand_in(EXPORTS)
    monkeypatch.setattr(film, "find_spec", lambda name: name)
    with plot.Film(patch[1], tmp_path / "film.html") as made:
        made.add()
        made.add()
    (label, page), second = pages(tmp_path / "film.html")
    assert page == "<p>a page</p>" and second == (label, page) and "pressure" in label
    (tmp_path / "stand_in" / "pyvista.py").write_text("raise ImportError('no libGL')")
    made = plot.Film(patch[1], tmp_path / "film.html")
    made.add()
    with pytest.raises(llm.ContactError, match="cannot export a page here.*no libGL"):
        made.close()
    with pytest.raises(llm.ContactInputError, match="in 2D write .gif"):
        plot.Film(pressed().problem, tmp_path / "film.html")
    monkeypatch.setattr(film, "find_spec", lambda name: None)
    with pytest.raises(llm.ContactInputError, match="pyvista and trame_vtk cannot be found"):
        plot.Film(patch[1], tmp_path / "film.html")


def test_film_for_browsers_by_pyvista(patch, tmp_path):
    """The page holds PyVista's own, with its data."""
    pytest.importorskip("pyvista")
    pytest.importorskip("trame_vtk")
    with plot.Film(patch[1], tmp_path / "film.html", colour="displacement") as made:
        made.add()
    ((label, page),) = pages(tmp_path / "film.html")
    assert "length of u" in label and "vtk" in page and len(page) > 100_000


def test_status_has_colours_of_its_own(patch, tmp_path, monkeypatch):
    """Cells have the status of most of their corners, and the bar names it."""
    found = []
    monkeypatch.setattr(plot, "draw_scene", lambda scene, path: found.append(scene))
    result = patch[1].results[0]
    cells = result.frame.corners
    marks = np.zeros(len(result.x), dtype=int)
    marks[cells[0]] = 1
    marks[cells[0, 0]] = 3
    result = replace(result, frame_status=marks)
    plot.interface(result, tmp_path / "status.png", "status")
    (scene,) = found
    assert list(scene.named) == ["open", "stick", "slip", "closed"]
    of_corners = [np.bincount(marks[cell], minlength=4) for cell in cells]
    assert scene.values[0] == 1 and set(scene.values) <= {0, 1, 3}
    assert all(counts[int(v)] == counts.max() for counts, v in zip(of_corners, scene.values))
    monkeypatch.undo()
    monkeypatch.setattr(render, "find_spec", lambda name: None)
    drawing.draw_scene(scene, tmp_path / "status.png")
    shade = np.array(colors.to_rgb(render.SHADES[1]))
    assert (np.abs(image(tmp_path / "status.png") - shade).max(axis=2) < 0.01).sum() > 500


@pytest.mark.long
def test_pyvista_draws_a_problem(patch, tmp_path, monkeypatch):
    pytest.importorskip("pyvista")
    monkeypatch.setattr(render, "_failed", False)
    patch[1].plot(tmp_path)
    if render._failed:
        pytest.skip("PyVista is here, but cannot draw")
    for name in ("bodies.png", "interface_0.png"):
        assert image(tmp_path / name).shape == (*render.PIXELS[::-1], 3)


def test_curved_frame_by_matplotlib(tmp_path, monkeypatch):
    """A surface without a mean normal is drawn in 3D."""
    monkeypatch.setattr(render, "find_spec", lambda name: None)
    angle = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    x = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    x = np.concatenate([x, x + [0, 0, 1]])
    k = np.arange(12)
    cells = np.column_stack([k, (k + 1) % 12, (k + 1) % 12 + 12, k + 12])
    frame = llm.Frame(x, cells, v=0.0 * x)
    zero = np.zeros(24)
    own = zero + 1.0, zero + 1.0, 0.0 * x, zero.astype(int), np.eye(4)[0] + np.zeros((24, 4))
    result = InterfaceResult(frame, (None,), None, *own)
    plot.interface(result, tmp_path / "ring.png")
    assert np.ptp(image(tmp_path / "ring.png")) > 0.9


@pytest.mark.parametrize("size", [(2.0, 2.0, 1.8), (10.0, 3.0, 2.0)], ids=str)
def test_bodies_fit_in_their_picture(size, monkeypatch):
    """By Matplotlib corners were cut off, and numbers along short edges lay upon each other."""
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import proj3d

    corners = np.array(list(itertools.product((0.0, 1.0), repeat=3))) * size
    faces = np.array([[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4]])
    figure = Figure(figsize=(8, 6))
    scene = render.Scene(corners, faces, np.zeros(8), (0.0, 1.0), "")
    drawing._draw_skin(figure, scene, np.ones((3, 4)))
    figure.savefig(io.BytesIO())
    axis = figure.axes[0]
    flat = np.column_stack(proj3d.proj_transform(*corners.T, axis.get_proj())[:2])
    inside = axis.bbox.contains
    assert all(inside(*at) for at in axis.transData.transform(flat))
    for k, name in enumerate("xyz"):
        ticks = getattr(axis, f"get_{name}ticks")()
        assert np.sum((ticks >= 0.0) & (ticks <= size[k])) <= 6.0 * max(size[k] / max(size), 0.34)


def test_marks_are_told_below_the_numbers():
    """Their legend lay upon the numbers of axes that are flat."""
    from matplotlib.figure import Figure

    x, cells = np.array([[0.0, 0], [6, 0], [6, 1], [0, 1]]), np.array([[0, 1, 2, 3]])
    figure = Figure(figsize=(8, 6))
    scene = render.Scene(x, cells, np.zeros(4), (0.0, 1.0), "", status=np.array([0, 1, 2, 3]))
    drawing._draw_skin(figure, scene, np.ones((1, 4)))
    figure.savefig(io.BytesIO())
    (axis,) = figure.axes
    lowest = min(number.get_window_extent().y0 for number in axis.get_xticklabels())
    assert axis.get_legend().get_window_extent().y1 < lowest


@pytest.mark.parametrize("kind", ["triangle", "hexahedron"])
def test_second_order_on_an_obstacle(kind, tmp_path, monkeypatch):
    """Nodes between corners are of the picture: they belonged to no cell, which was an error."""
    monkeypatch.setattr(render, "find_spec", lambda name: None)
    gdim, cell = (2 if kind == "triangle" else 3), getattr(mesh.CellType, kind)
    make = mesh.create_unit_square if gdim == 2 else mesh.create_unit_cube
    domain = make(COMM, *[2] * gdim, cell)
    V = compat.function_space(domain, degree=2, shape=(gdim,))
    foot = mesh.locate_entities_boundary(domain, gdim - 1, lambda x: np.isclose(x[gdim - 1], 0.0))
    tags = mesh.meshtags(domain, gdim - 1, np.sort(foot), np.ones(len(foot), dtype=np.int32))
    down = np.eye(gdim)[-1]
    bc = fem.dirichletbc(
        fem.Constant(domain, -0.01 * down),
        fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[gdim - 1], 1.0)),
        V,
    )
    floor = llm.RigidPlane(0.0 * down, down)
    interface = llm.Interface(tags, (1, floor), law=llm.Frictionless())
    problem = llm.ContactProblem(*scenes.forms(V), bcs=[bc], interfaces=[interface])
    problem.solve()
    problem.plot(tmp_path, colour="pressure")
    for name in ("bodies.png", "interface_0.png"):
        assert np.ptp(image(tmp_path / name)) > 0.9
    side = problem.results[0].sides[0]
    assert np.unique(side.facets).tolist() == list(range(len(side.x)))


def test_colours_of_bodies(tmp_path, monkeypatch):
    """Two meshes in one picture, by pressure, status, displacement and a function; a film."""
    from PIL import Image

    scene = pressed()
    for colour in ("pressure", "displacement", lambda u: u[1]):
        scene.problem.plot(tmp_path, colour=colour)
        assert np.ptp(image(tmp_path / "bodies.png")) > 0.9
    with plot.Film(scene.problem, tmp_path / "film.gif", colour="status") as film:
        film.add()
        push(scene, 0.02)
        film.add()
    with Image.open(tmp_path / "film.gif") as found:
        assert found.n_frames == 2
    with pytest.raises(llm.ContactInputError, match="colour='force': choose one of"):
        scene.problem.plot(tmp_path, colour="force")
    with pytest.raises(llm.ContactInputError, match="section=.*of a plane in 3D"):
        scene.problem.plot(tmp_path, section=((0, 0, 0), (1, 0, 0)))


def test_surface_of_several_interfaces():
    """What presses on a surface is seen, whichever of its interfaces comes first."""
    problem = pressed().problem
    seen = bodies.View("pressure", "", 1.0, None).seen(COMM, problem.u, problem.results)
    (result,) = seen.results
    none = 0.0 * result.frame_force
    quiet = replace(result, frame_force=none, frame_status=none.astype(int))
    alone = seen.scene()
    for results in ([result, quiet], [quiet, result]):
        both = replace(seen, results=results).scene()
        assert len(both.cells) == len(alone.cells)
        assert both.values[both.cells].sum() == pytest.approx(alone.values[alone.cells].sum())
        assert (both.status == -1).sum() == len(none)
    silent = replace(quiet, frame_density=0.0 * result.frame_density)
    assert replace(seen, results=[silent]).scene().limits[0] == 0.0  # -1e-300, below a film's bar


@pytest.mark.parametrize("kind", ["tetrahedron", "hexahedron"])
def test_sections_and_outlines(kind):
    """Of a box cut in the middle the skin is that of its half, with the edges of the whole."""
    domain = mesh.create_box(
        COMM, [np.zeros(3), np.array([4.0, 1.0, 1.0])], [4, 2, 2], getattr(mesh.CellType, kind)
    )
    u = fem.Function(compat.function_space(domain, shape=(3,)))
    for section, area, edges in (
        (None, 18.0, 24.0),
        ((np.array([2.0, 0, 0]), np.eye(3)[0]), 10, 16),
    ):
        found = bodies.skin(u, section=section)
        cells = np.arange(found.nodes.size).reshape(found.nodes.shape)
        areas = vector_areas(found.x.reshape(-1, 3), cells)
        assert np.linalg.norm(areas, axis=1).sum() == pytest.approx(area)
        way = np.linalg.norm(np.diff(bodies.outline([found]), axis=1), axis=2)
        assert way.sum() == pytest.approx(edges)


def test_wrong_field(patch, tmp_path):
    with pytest.raises(llm.ContactInputError, match="field='force': choose one of"):
        patch[1].plot(tmp_path, "force")


def test_pictures_gather_the_surface_alone():
    """As many polygons as the bodies have outer facets, with the surface's area."""
    found = run_mpi_json("skin.py", 3)
    assert found["area"] == pytest.approx(found["surface"], rel=1e-12)
    assert found["polygons"] == run_mpi_json("skin.py", 1)["polygons"]


# ## Files
def grid(path):
    """Points, cells, their kind and fields of a VTU."""
    piece = ElementTree.parse(path).getroot().find("UnstructuredGrid/Piece")
    parts = {}
    for part in piece:
        parts[part.tag] = {}
        for array in part:
            raw = b64decode(array.text)
            assert int.from_bytes(raw[:8], "little") == len(raw) - 8
            values = np.frombuffer(raw[8:], array.get("type").lower())
            size = int(array.get("NumberOfComponents", 1))
            parts[part.tag][array.get("Name")] = values.reshape(-1, size) if size > 1 else values
    cells = parts["Cells"]["connectivity"].reshape(int(piece.get("NumberOfCells")), -1)
    assert (parts["Cells"]["offsets"] == cells.shape[1] * np.arange(1, len(cells) + 1)).all()
    (kind,) = set(parts["Cells"]["types"].tolist())
    return parts["Points"]["points"], cells, kind, parts["PointData"], parts["CellData"]


def series(path):
    """Times and files of an index."""
    steps = {}
    for entry in ElementTree.parse(path).iter("DataSet"):
        steps.setdefault(float(entry.get("timestep")), []).append(path.parent / entry.get("file"))
    return steps


def agree(path, part):
    x, cells, fields = part
    gdim = x.shape[1]
    points, found, kind, values, _ = grid(path)
    assert kind == {2: 3, 3: 5, 4: 9}[cells.shape[1]]
    assert (points[:, :gdim] == x).all() and (found == cells).all()
    assert values.keys() == fields.keys()
    for name, value in fields.items():
        if np.ndim(value) == 2:
            assert not values[name][:, gdim:].any()
        assert (values[name][:, :gdim] if np.ndim(value) == 2 else values[name]).tolist() == (
            value.tolist()
        )


def test_interface_files(patch, tmp_path):
    """Every number of frame and sides comes back as it was, as VTU and as CSV."""
    result = patch[1].results[0]
    post.write_interface(tmp_path, result)
    parts = post.interface_fields(result)
    assert list(parts) == ["frame", "side_0", "side_1"]
    for name, part in parts.items():
        agree(tmp_path / f"{name}.vtu", part)
        table = np.genfromtxt(tmp_path / f"{name}.csv", delimiter=",", names=True)
        assert (table["displacement_z"] == part[2]["displacement"][:, 2]).all()


def test_load_steps(tmp_path):
    """A series of frame, sides and bodies; each step is that of its solve."""
    scene, kept, fields = pressed(), [], {"along": lambda u: u[0]}
    problem = scene.problem
    with post.LoadSteps(
        problem, tmp_path, cell_fields=lambda u: {name: f(u) for name, f in fields.items()}
    ) as files:
        for time in (None, 2.5):
            files.write(time)
            kept.append((post.interface_fields(problem.results[0]), problem._u[1].x.array.copy()))
            push(scene, 0.02)
    for name in ("frame", "side_0", "side_1"):
        found = series(tmp_path / "interface_0" / f"{name}.pvd")
        assert list(found) == [0.0, 2.5]
        for (file,), (parts, _) in zip(found.values(), kept, strict=True):
            agree(file, parts[name])
    found = series(tmp_path / "bodies_1.pvd")
    for (file,), (_, u) in zip(found.values(), kept, strict=True):
        *_, at_nodes, in_cells = grid(file)
        values = at_nodes["displacement"][:, :2]
        assert np.sort(values.ravel()) == pytest.approx(np.sort(u), abs=1e-15)
        along = in_cells["along"]
        assert len(along) == 20 and (u.min() < along).all() and (along < u.max()).all()


@pytest.mark.parametrize("obstacle", [False, True], ids=["bodies", "obstacle"])
def test_finite_deformation(obstacle, tmp_path):
    """Series and pictures of a nonlinear problem: points as drawn, which displacements take to
    where the surfaces are now."""
    scene = finite_patch.bodies(COMM, "quad", 1, True)
    problem = finite_patch.problem(scene, pressure=50.0)
    if obstacle:
        domain, tags = scene[0]
        V = compat.function_space(domain, shape=(2,))
        u, bottom = fem.Function(V), lambda p: np.isclose(p[1], 0.0)
        F = ufl.derivative(finite_patch.energy(u, 300.0, 500.0) * ufl.dx, u, ufl.TestFunction(V))
        bc = fem.dirichletbc(fem.Function(V), fem.locate_dofs_geometrical(V, bottom))
        floor = llm.RigidPlane((0.0, 0.9), (0.0, -1.0))
        sides = (finite_patch.FOUNDATION_TOP, floor)
        interface = llm.Interface(tags, sides, law=llm.Frictionless())
        problem = llm.NonlinearContactProblem(F, u, bcs=[bc], interfaces=[interface])
    with post.LoadSteps(problem, tmp_path) as files:
        for _ in range(2):
            problem.solve()
            files.write()
    result = problem.results[0]
    parts = post.interface_fields(result)
    assert parts.keys() == ({"side_0"} if obstacle else {"frame", "side_0", "side_1"})
    for name, (x, _, fields) in parts.items():
        agree(tmp_path / "interface_0" / f"{name}_1.vtu", parts[name])
        now = result.x if name == "frame" else result.sides[int(name[-1])].x
        assert np.abs(x + fields["displacement"] - now).max() < 1e-14
        assert np.isfinite(fields["status" if name == "frame" else "gap"]).all()
    assert np.abs(result.deformed - result.x).max() < 1e-14
    drawn = result.sides[0].drawn if obstacle else result.frame_drawn
    assert np.abs(result.moved(3.0) - (3.0 * result.x - 2.0 * drawn)).max() < 1e-14
    # A gap may be larger than the body; where there is none a number stands for it.
    gaps = np.where(np.arange(len(result.sides[0].gap)) == 1, np.inf, 1e3)
    afar = replace(result, sides=(replace(result.sides[0], gap=gaps), *result.sides[1:]))
    assert (post.interface_fields(afar)["side_0"][2]["gap"] == 1e3).all()
    problem.plot(tmp_path / "pictures")
    assert (tmp_path / "pictures" / "interface_0.png").exists()


@pytest.mark.parametrize("make", [llm.ContactProblem, mixed.nonlinear], ids=["linear", "finite"])
def test_mixed_spaces(make, tmp_path):
    """Of (p, u) the displacement is written, by steps and alone."""
    blocks = ("DG", 1, False), ("Lagrange", 2, True)
    problem = mixed.pressed(llm.Frictionless(), blocks, COMM, "saddle", make)
    w = problem.solve()
    with post.LoadSteps(problem, tmp_path) as files:
        files.write()
    post.write_bodies(tmp_path / "alone.pvd", w)
    post.write_bodies(tmp_path / "listed.pvd", [w])
    u = np.sort(w.sub(1).collapse().x.array)
    for name in ("bodies_0", "alone", "listed"):
        ((file,),) = series(tmp_path / f"{name}.pvd").values()
        *_, at_nodes, _ = grid(file)
        found = np.sort(at_nodes["displacement"][:, :2].ravel())
        np.testing.assert_allclose(found, u, atol=1e-15)


def test_pyvista_and_meshio_read_the_series(tmp_path):
    """VTK's reader, which is ParaView's, finds steps, points and fields; meshio each file; stress
    of cells and displacement stand in one grid."""
    pyvista, meshio = pytest.importorskip("pyvista"), pytest.importorskip("meshio")
    scene = pressed()
    with post.LoadSteps(scene.problem, tmp_path, cell_fields=lambda u: {"stress": u[1]}) as files:
        files.write()
        push(scene, 0.02)
        files.write()
    reader = pyvista.get_reader(str(tmp_path / "interface_0" / "side_0.pvd"))
    assert list(reader.time_values) == [0.0, 1.0]
    reader.set_active_time_value(1.0)
    (surface,) = reader.read()
    side = scene.problem.results[0].sides[0]
    assert surface.points[:, :2] == pytest.approx(side.x)
    assert surface["force"][:, :2] == pytest.approx(side.force)
    assert surface.n_cells == len(side.facets)
    (body,) = pyvista.get_reader(str(tmp_path / "bodies_1.pvd")).read()
    lowest = body.warp_by_vector("displacement").cell_centers().points[body["stress"].argmin()]
    assert body.compute_cell_sizes()["Area"].sum() == pytest.approx(1.0) and lowest[1] > 1.0
    for path in tmp_path.rglob("*.vtu"):
        read = meshio.read(path)
        own = grid(path)
        assert (read.points == own[0]).all() and (read.cells[0].data == own[1]).all()
        assert read.point_data.keys() == own[3].keys() and read.cell_data.keys() == own[4].keys()


@pytest.mark.long
def test_every_file_reads_back(patch, tmp_path, monkeypatch):
    """What every writer has written, by the reader of its kind: collections with a block per body,
    displacements and stress of bodies, pressures of frames and forces of sides by meshio and by
    PyVista."""
    pyvista, meshio = pytest.importorskip("pyvista"), pytest.importorskip("meshio")
    from PIL import Image

    monkeypatch.setattr(render, "find_spec", lambda name: None)
    scene = pressed()
    problem, result = scene.problem, scene.problem.results[0]
    others = [".bp"] * has_adios2 + [".vtkhdf"] * (compat.io_module("vtkhdf") is not None)
    with plot.Film(problem, tmp_path / "film.gif") as film:
        film.add()
    problem.plot(tmp_path)
    plot.frame_design(patch[1].results[0], None, tmp_path / "design.png")
    plot.curves([("a", "-", [1.0, 2.0], [3.0, 4.0])], tmp_path / "curves.png")
    problem.save(tmp_path / "state.npz")
    post.write_interface(tmp_path / "alone", result)
    with post.LoadSteps(problem, tmp_path / "steps", cell_fields=stress_of) as files:
        files.write()
    for i, u in enumerate(problem.u):
        for suffix in (".pvd", *others):
            fields = stress_of(u) if suffix == ".pvd" else None
            post.write_bodies(tmp_path / f"body_{i}{suffix}", u, fields)
    both = tmp_path / "both" / "bodies.pvd"
    post.write_bodies(both, problem.u, [stress_of(u) for u in problem.u])
    seen = set()
    for path in sorted(p for p in tmp_path.rglob("*.*") if ".bp" not in p.parent.suffix):
        seen.add(path.suffix)
        if path.suffix == ".png":
            assert np.ptp(image(path)) > 0.5
        elif path.suffix == ".gif":
            with Image.open(path) as found:
                assert np.ptp(np.asarray(found.convert("L"))) > 100
        elif path.suffix == ".npz":
            with np.load(path) as found:
                assert all(
                    np.isfinite(found[name]).all()
                    for name in found
                    if found[name].dtype.kind == "f"
                )
        elif path.suffix == ".csv":
            table = np.genfromtxt(path, delimiter=",", names=True)
            assert len(table) > 1 and {"displacement_x", "displacement_y"} <= {*table.dtype.names}
        elif path.suffix == ".pvd":
            blocks = pyvista.get_reader(str(path)).read()
            assert len(blocks) == 1 + (path == both)
            assert all("displacement" in block.point_data for block in blocks)
        elif path.suffix == ".vtkhdf":
            assert "u" in pyvista.get_reader(str(path)).read().point_data
        elif path.suffix == ".vtu":
            one, other = meshio.read(path), pyvista.read(path)
            moved = one.points + one.point_data["displacement"]
            assert np.abs(moved - one.points).max() > 1e-3
            np.testing.assert_array_equal(other.warp_by_vector("displacement").points, moved)
            if "bod" in path.name:
                value = one.cell_data["stress"][0]
                assert len(value) == len(one.cells[0].data) and value.min() > 0.0
                np.testing.assert_array_equal(other.cell_data["stress"], value)
            else:
                value = one.point_data["pressure" if "frame" in path.name else "force"]
                assert len(value) == len(moved) and np.abs(value).max() > 0.0
    assert seen == {".png", ".gif", ".npz", ".csv", ".pvd", ".vtu", *others}


def stress_of(u):
    """Von Mises' stress in plane strain, of moduli 1."""
    eps = ufl.sym(ufl.grad(u))
    plane = [[eps[i, j] if i < 2 and j < 2 else 0.0 for j in range(3)] for i in range(3)]
    return {"stress": post.von_mises(ufl.as_tensor(plane) + ufl.tr(eps) * ufl.Identity(3))}


@pytest.mark.parametrize("kind", ["triangle", "quadrilateral", "tetrahedron", "hexahedron"])
def test_nodes_of_cells(kind, tmp_path):
    """Nodes of a file's cells lie where VTK has them, of first and second order."""
    pyvista = pytest.importorskip("pyvista")
    flat = kind in ("triangle", "quadrilateral")
    create = mesh.create_rectangle if flat else mesh.create_box
    size = (1.0, 2.0, 4.0)[: 2 if flat else 3]
    corners = [np.zeros(len(size)), np.array(size)]
    domain = create(COMM, corners, [1] * len(size), getattr(mesh.CellType, kind))
    for degree in (1, 2):
        u = fem.Function(compat.function_space(domain, "Lagrange", degree, (len(size),)))
        post.write_bodies(tmp_path / "u.pvd", u)
        (found,) = pyvista.get_reader(str(tmp_path / "u.pvd")).read()
        for k in range(found.n_cells):
            at = np.reshape(found.GetCell(k).GetParametricCoords(), (-1, 3))
            affine = np.column_stack([at, np.ones(len(at))])
            x = found.get_cell(k).points
            assert np.abs(affine @ np.linalg.lstsq(affine, x, rcond=None)[0] - x).max() < 1e-14


def test_vtkhdf(patch, tmp_path):
    """The displacement is that of the corners, step by step; from dolfinx 0.10 on."""
    u, problem = patch
    if compat.io_module("vtkhdf") is None:
        with pytest.raises(llm.ContactInputError, match="has no VTKHDF.*Write .pvd"):
            post.write_bodies(tmp_path / "bodies.vtkhdf", u)
        return
    with post.LoadSteps(problem, tmp_path, suffix=".vtkhdf") as files:
        files.write()
        files.write()
    with pytest.raises(llm.ContactInputError, match="cell_fields and several meshes are for .pvd"):
        post.write_bodies(tmp_path / "other.vtkhdf", u, {"x": u[0]})
    path = tmp_path / "bodies_0.vtkhdf"
    mesh = compat.io_module("vtkhdf").read_mesh(COMM, str(path))
    size = mesh.geometry.index_map().size_local
    assert size == u.function_space.mesh.geometry.index_map().size_local
    known = tree(u.function_space.tabulate_dof_coordinates())
    pyvista = pytest.importorskip("pyvista")
    grid = pyvista.get_reader(path).read()
    far, near = known.query(grid.points)
    assert far.max() < 1e-12
    np.testing.assert_allclose(grid["u"], u.x.array.reshape(-1, 3)[near], atol=1e-12)


def test_vtx(patch, tmp_path):
    """BP4 holds raw numbers: those of the displacement are found in it."""
    u, problem = patch
    if not has_adios2:
        with pytest.raises(llm.ContactInputError, match="without ADIOS2.*Write .pvd"):
            post.write_bodies(tmp_path / "bodies.bp", u)
        return
    post.write_bodies(tmp_path / "out" / "bodies.bp", u)
    with post.LoadSteps(problem, tmp_path, suffix=".bp") as files:
        files.write()
        files.write()
    for name, count in (("out/bodies.bp", 1), ("bodies_0.bp", 2)):
        data = b"".join(path.read_bytes() for path in (tmp_path / name).iterdir())
        assert data.count(u.x.array.tobytes()) == count
    with pytest.raises(llm.ContactInputError, match="cell_fields and several meshes are for .pvd"):
        post.write_bodies(tmp_path / "other.bp", u, {"x": u[0]})


def test_errors_of_files(patch, tmp_path):
    with pytest.raises(llm.ContactInputError, match="must end on .pvd or .bp or .vtkhdf"):
        post.write_bodies(tmp_path / "bodies.vtu", patch[0])
    low = pairs.block(COMM, (2, 2, 1), (-1.0, -1.0, 0.0), (1.0, 1.0, 1.0), "tetrahedron")
    high = pairs.block(COMM, (3, 3, 1), (-0.5, -0.5, 1.0), (0.5, 0.5, 2.0), "hexahedron")
    scene = Pressed([low, high], llm.Frictionless(), lambda p: p[2] > 1.99, lambda p: p[2] < 0.01)
    with post.LoadSteps(scene.problem, tmp_path) as files:
        with pytest.raises(llm.ContactError, match="nothing to write yet"):
            files.write()


def test_another_working_directory(tmp_path, monkeypatch):
    """What was named relative to the first one stays there."""
    monkeypatch.chdir(tmp_path)
    scene = pressed()
    scene.problem.solve()
    with post.LoadSteps(scene.problem, "steps") as files, plot.Film(scene.problem, "f.gif") as film:
        (tmp_path / "elsewhere").mkdir()
        monkeypatch.chdir(tmp_path / "elsewhere")
        files.write()
        film.add()
    assert not list((tmp_path / "elsewhere").iterdir())
    assert (tmp_path / "f.gif").exists() and (tmp_path / "steps" / "bodies_0.pvd").exists()
