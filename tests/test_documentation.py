"""Every public name says what it is, and what of which shape goes in and out; examples are true."""

import ast
import dataclasses
import doctest
import importlib
import importlib.util
import inspect
import re
import sys
import textwrap
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest
import scenes
from conftest import TESTS
from mpi4py import MPI

import dolfinx_llm


def tool(name):
    """A module of .ci."""
    spec = importlib.util.spec_from_file_location(f"ci_{name}", TESTS.parent / f".ci/{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look for their types
    spec.loader.exec_module(module)
    return module


docs, figures, gallery = tool("docs"), tool("figures"), tool("gallery")

EXAMPLES = [
    "geometry.frame", "laws.tied", "laws.frictionless", "laws.coulomb", "laws.complementarity",
    "laws.conductance", "laws.sliding",
    "contact.equations.speakers", "interface.obstacle", "interface.obstacles",
    "design.weights",
]  # fmt: skip


def public():
    """Name to object of all that users call or get back: functions, classes and their methods."""
    found = {}
    for name in docs.MODULES | dict.fromkeys(docs.SUBMODULES):
        module = importlib.import_module(name)
        names = docs.MODULES.get(name) or getattr(module, "__all__", vars(module))
        for key in names:
            item = getattr(module, key)
            ours = getattr(item, "__module__", "").startswith("dolfinx_llm")
            if key.startswith("_") or not callable(item) or not ours:
                continue
            if names is vars(module) and item.__module__ != module.__name__:
                continue
            found[f"{item.__module__}.{key}"] = item
            if inspect.isclass(item):
                found |= members(f"{item.__module__}.{key}", item)
    return found


def members(name, cls):
    """Public methods and properties, also inherited ones of the package's own classes."""
    own = [base for base in cls.__mro__ if base.__module__.startswith("dolfinx_llm")]
    keys = {key for base in own for key in vars(base) if not key.startswith("_")}
    found = {f"{name}.{key}": inspect.getattr_static(cls, key) for key in sorted(keys)}
    kinds = (property, classmethod, staticmethod, cached_property)
    return {k: v for k, v in found.items() if inspect.isfunction(v) or isinstance(v, kinds)}


def function_of(item):
    """The function behind a method or property; of a class its __init__."""
    if inspect.isclass(item):
        return item.__init__
    for attribute in ("fget", "func", "__func__"):
        item = getattr(item, attribute, item)
    return item


def text_of(name, item):
    """Docstring; of a method also that of the one it overrides."""
    if inspect.isclass(item):
        return item.__doc__ or ""
    owner, _, key = name.rpartition(".")
    cls = PUBLIC.get(owner)
    return inspect.getdoc(getattr(cls, key, None) if cls else item) or inspect.getdoc(item) or ""


def arguments(item):
    if inspect.isclass(item) and issubclass(item, Exception):
        return []
    parameters = inspect.signature(function_of(item)).parameters.values()
    return [p for p in parameters if p.name not in ("self", "cls")]


def described(text):
    """Argument to description, from the sections Args and Attributes."""
    found, section, last = {}, "", ""
    for line in inspect.cleandoc(text).splitlines():
        if line and not line.startswith(" "):
            section = line.strip()
        elif section in ("Args:", "Attributes:"):
            if entry := re.match(r"    ((?:\w+, )*\w+): (.*)", line):
                last = entry[1]
                found |= dict.fromkeys(last.split(", "), entry[2])
            elif last:
                for key in last.split(", "):
                    found[key] += " " + line.strip()
    return found


PUBLIC = public()
FUNCTIONS = {k: v for k, v in PUBLIC.items() if not isinstance(v, (property, cached_property))}


def test_the_list_is_not_empty():
    """What the checks below run over."""
    assert set(dolfinx_llm.__all__) <= {k.rsplit(".")[-1] for k in [*PUBLIC, *docs.SUBMODULES]}
    for name in ("problem.problem.ContactProblem.solve",
                 "contact.results.sides.SideResult.tangential_force",
                 "interface.obstacles.RigidPlane.clearance",
                 "problem.classical.node_to_segment.NodeToSegment", "output.plot.interface",
                 "geometry.frame.Frame.from_gmsh", "output.files.write_interface"):  # fmt: skip
        assert f"dolfinx_llm.{name}" in PUBLIC, name


def test_documented():
    for name, item in PUBLIC.items():
        text = text_of(name, item)
        assert len(text.split()) >= 3 and not re.match(r"\w+\(.*\)$", text.strip()), name
        entries = described(text)
        if dataclasses.is_dataclass(item):
            entries = docs.field_comments(item) | entries
        for argument in [] if name not in FUNCTIONS else arguments(item):
            told = f"{name}: {argument.name}"
            assert argument.name in entries, f"{told} is not described"
            if "ndarray" in str(argument.annotation):
                assert re.search(r"\(\w.*\)", entries[argument.name]), f"{told}: which shape?"


def test_annotated():
    for name, item in PUBLIC.items():
        for argument in arguments(item):
            assert argument.annotation is not argument.empty, f"{name}: {argument.name} has no type"
        if not inspect.isclass(item):
            returned = inspect.signature(function_of(item)).return_annotation
            assert returned is not inspect.Signature.empty, f"{name}: no type of what it returns"


def test_errors_are_named():
    """The errors that a function or a class raises itself stand in its docstring."""
    for name, item in FUNCTIONS.items():
        bodies = [function_of(item)]
        if inspect.isclass(item):
            bodies = [vars(item).get(key) for key in ("__init__", "__post_init__")]
        raised = set()
        for body in filter(inspect.isfunction, bodies):
            if dataclasses.is_dataclass(item) and body.__name__ == "__init__":
                continue  # generated
            tree = ast.parse(textwrap.dedent(inspect.getsource(body)))
            for node in ast.walk(tree):
                if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                    raised.add(node.exc.func.id)
        text = text_of(name, item).partition("Raises:")[2]
        missing = {error for error in raised - {"NotImplementedError"} if error not in text}
        assert not missing, f"{name}: not in the section Raises"


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples(name):
    outcome = doctest.testmod(importlib.import_module(f"dolfinx_llm.{name}"))
    assert outcome.attempted and not outcome.failed


# The pages' tables, against the code.
ROOT = TESTS.parent
PAGES = {
    path.relative_to(ROOT).as_posix(): path.read_text()
    for path in (ROOT / "README.md", ROOT / "demos/README.md", *ROOT.glob("dolfinx_llm/**/*.md"))
}
MESSAGES, OPTIONS = PAGES["dolfinx_llm/base/messages.md"], PAGES["dolfinx_llm/problem/options.md"]


def strings():
    """All strings of the package, values that are filled in as {}."""
    found = []
    for path in sorted((TESTS.parent / "dolfinx_llm").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.JoinedStr):
                parts = [getattr(part, "value", None) for part in node.values]
                found.append("".join(p if isinstance(p, str) else "{}" for p in parts))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
    return "\n".join(found)


def test_messages_of_the_page_are_the_codes():
    said = strings()
    rows = re.findall(r"^\| `(.+?)`.* \| .+ \| .+ \|$", MESSAGES, re.M)
    assert len(rows) > 15
    assert [words for words in rows if words not in said] == []


@pytest.mark.parametrize(
    "name",
    ["Interface", "find_interfaces", "ContactProblem", "ContactProblem.solve",
     "ContactProblem.plot", "Tied", "Coulomb",
     "RigidPlane", "RigidSphere", "RigidCylinder", "RigidSurface", "TimeStepper"],
)  # fmt: skip
def test_options_of_the_page_are_complete(name):
    item = dolfinx_llm
    for part in name.split("."):
        item = getattr(item, part)
    tables = re.findall(r"^\|.*", OPTIONS, re.M)
    quoted = " ".join(re.findall(r"`([^`]+)`", "\n".join(tables)))
    words = set(re.findall(r"\w+", quoted))
    assert {p.name for p in arguments(item)} <= words
    assert {"reset", "solve", "destroy", "plot"} <= words


def test_pages_do_not_name_what_is_not_there():
    """Names of llm in the pages, make's targets, and files that they link to."""
    text = "\n".join(PAGES.values())
    names = set(re.findall(r"\bllm\.(\w+)", text))
    assert len(names) > 10 and names <= set(dolfinx_llm.__all__)
    targets = set(re.findall(r"`make (\w+)`", text))
    makefile = (ROOT / "Makefile").read_text()
    assert targets and all(f"\n{target}:" in makefile for target in targets)
    for page, content in PAGES.items():
        for link in re.findall(r"\]\(([^)#:]+)\)", content):
            assert (ROOT / page).parent.joinpath(link).exists(), f"{page}: {link}"


def blocks():
    """Page, and code, of what the pages write in Python about this package."""
    for page, content in PAGES.items():
        for code in re.findall(r"^```python\n(.*?)^```", content, re.M | re.S):
            yield page, code


def test_code_of_the_pages_has_arguments_that_exist():
    """It is Python, and calls of llm name arguments that are there."""
    checked = 0
    for page, code in blocks():
        for node in ast.walk(ast.parse(code)):
            name = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
            if not name.startswith("llm."):
                continue
            item = dolfinx_llm
            for part in name.split(".")[1:]:
                item = getattr(item, part)
            accepted = inspect.signature(item).parameters
            free = any(p.kind == p.VAR_KEYWORD for p in accepted.values())
            given = {k.arg for k in node.keywords if k.arg}
            assert free or given <= set(accepted), f"{page}: {name}({given - set(accepted)})"
            checked += 1
    assert checked > 20


@pytest.mark.long
def test_use_of_the_readme_runs(tmp_path, monkeypatch):
    """As it stands, with what it says that there is."""
    monkeypatch.chdir(tmp_path)
    V, tags = scenes.two_blocks(MPI.COMM_SELF, 3, 2)
    a, L = scenes.forms(V)
    held = [*scenes.SYMMETRY, (2, scenes.on(2, 2.0))]
    bcs = scenes.hold(V, held, lambda p: np.stack([0.0 * p[0], 0.0 * p[0], -0.01 * p[2]]))
    (code,) = (code for page, code in blocks() if page == "README.md")
    there = {"V": V, "tags": tags, "a": a, "L": L, "bcs": bcs}
    exec(code.replace("(3, 7)", "(2, 3)"), there)
    assert there["result"].pressure.min() > 0.0
    assert {"bodies.pvd", "bodies.png", "frame.vtu"} <= {p.name for p in Path("out").iterdir()}


def test_readme_is_a_front_page():
    assert len(PAGES["README.md"].splitlines()) <= 120


def test_readme_is_checked_against_runs():
    """What README says is taken for a run's, and a figure beyond its bound is told."""
    readme = PAGES["README.md"]
    lines = readme.partition(figures.BEGIN)[2].partition(figures.END)[0].strip().splitlines()
    assert len(lines) == 2 + len(figures.ROWS)
    for line, row in zip(lines[2:], figures.ROWS):
        said = row.said(readme)
        assert row.line(said) == line and row.faults(readme, said) == []
        for k, figure in enumerate(row.figures):
            off = list(said)
            off[k] = said[k] * 11.0 if figure.times else said[k] + figure.differs + 1e-6
            (fault,) = row.faults(readme, off)
            assert row.scene in fault and f"says {said[k]}" in fault


def test_every_demo_has_a_page(tmp_path, monkeypatch):
    """Of its docstring, its code and what a run left; the index shows its picture. Links between
    pages lead to files."""
    pytest.importorskip("markdown2")
    pytest.importorskip("pygments")
    monkeypatch.setattr(gallery, "KEPT", tmp_path / "kept")
    kept = tmp_path / "kept" / "slope"
    kept.mkdir(parents=True)
    (kept / "slope.png").write_bytes(b"picture")
    (kept / "printed.txt").write_text("acceleration < 1.0006")
    (kept / "run.json").write_text('{"command": "python demos/slope.py", "seconds": 3.2}')
    gallery.main(["pages", str(tmp_path / "docs")])
    assert len(gallery.demos()) > 20 and "paper_data" not in gallery.demos()
    for name in gallery.demos():
        text = (tmp_path / "docs" / "demos" / f"{name}.html").read_text()
        assert "make gallery" in text or name == "slope"
        assert all(word in text for word in ("<h2>Code</h2>", "import"))
    page = (tmp_path / "docs" / "demos" / "slope.html").read_text()
    assert "acceleration &lt; 1.0006" in page and "at rest or sliding" in page
    assert (tmp_path / "docs" / "demos" / "slope_slope.png").read_bytes() == b"picture"
    for path in (tmp_path / "docs").rglob("*.html"):
        for link in re.findall(r'(?:href|src)="([^"#:]+)"', path.read_text()):
            ours = not link.endswith(("dolfinx_llm.html", ".py"))  # pdoc's; the repository's
            assert not ours or path.parent.joinpath(link).exists(), f"{path}: {link}"


def test_parts_of_the_gallery_are_all_of_it():
    parts = [gallery.chosen([f"{k}/3"]) for k in range(3)]
    assert sorted(sum(parts, [])) == list(gallery.demos()) == gallery.chosen([])


def test_every_demo_draws():
    """The gallery runs those that it names with options of their own, all others with --plot."""
    assert set(gallery.OPTIONS) <= set(gallery.demos())
    for name in set(gallery.demos()) - set(gallery.OPTIONS):
        assert '"--plot"' in (ROOT / "demos" / f"{name}.py").read_text(), name
