"""The rooms of the package: what may import what."""

import ast
import re
from pathlib import Path

import pytest

import dolfinx_llm

pytestmark = pytest.mark.quick

PACKAGE = Path(dolfinx_llm.__file__).parent
# From the ground up: a package imports those before it, never one after.
ROOMS = (
    "base", "geometry", "laws", "design", "interface", "operators", "forms", "finite", "contact",
    "output", "problem", "time",
)  # fmt: skip


def imports(path):
    """Modules of the package that a file imports, also inside of functions."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("dolfinx_llm"):
            yield node.module, node.lineno
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
            yield from ((name, node.lineno) for name in names if name.startswith("dolfinx_llm"))


def test_every_package_is_a_room():
    folders = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert folders == set(ROOMS)
    assert [path.name for path in PACKAGE.glob("*.py")] == ["__init__.py"]


def test_imports_run_downward():
    wrong = []
    for path in sorted(PACKAGE.rglob("*.py")):
        room, *rest = path.relative_to(PACKAGE).parts
        for module, line in imports(path) if rest else []:
            target = module.split(".")[1:2]
            if not target or ROOMS.index(target[0]) > ROOMS.index(room):
                wrong.append(f"{path.relative_to(PACKAGE)}:{line} imports {module}")
    assert not wrong


# Folders of a room, from the ground up, and where its own files stand among them.
FOLDERS = {
    "contact": ("equations", "search", "contact", "results"),
    "finite": ("frame", "pairs", "obstacles", "own_laws", "linear", "finite"),
}


@pytest.mark.parametrize("room", FOLDERS)
def test_folders_of_a_room_import_downward(room):
    """As the page on the method lists them."""
    page, order, wrong = (PACKAGE / "method.md").read_text(), FOLDERS[room], []
    table = re.search(rf"Within `{room}`[^|]*((?:^\|.*\n)+)", page, re.M).group(1)
    listed = re.findall(r"^\| `(\w+)` \|", table, re.M)
    root = PACKAGE / room
    folders = {path.parent.name for path in root.glob("*/__init__.py")}
    assert listed == [name for name in order if name != room] and folders == set(listed)
    for path in sorted(root.rglob("*.py")):
        for module, line in imports(path):
            _, other, target, *rest = [*module.split("."), "", ""]
            target = target if any(rest) else room
            if other == room and order.index(target) > order.index(path.parent.name):
                wrong.append(f"{path.relative_to(PACKAGE)}:{line} imports {module}")
    assert not wrong


def test_picture_of_the_rooms_shows_the_imports():
    """Arrows of the picture in the page on the method, and who imports whom."""
    page = (PACKAGE / "method.md").read_text()
    drawn = set(re.findall(r"^    (\w+) --> (\w+)$", page, re.M))
    found = set()
    for path in PACKAGE.rglob("*.py"):
        room, *rest = path.relative_to(PACKAGE).parts
        targets = {module.split(".")[1] for module, _ in imports(path) if rest}
        found |= {(room, target) for target in targets - {room, "base"}}
    assert drawn == found, "draw: " + ", ".join(f"{a} --> {b}" for a, b in sorted(found))


def test_what_holds_arrays_is_compared_by_identity():
    """Equality of arrays is an array: to ask for it in a list raises where it has several parts."""
    held = "ndarray", "csr_matrix", "Array", "Frame", "Surface", "ContactPairs", "InterfaceState"
    wrong, seen = [], 0
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.ClassDef):
                continue
            made = [ast.unparse(d) for d in node.decorator_list]
            fields = [ast.unparse(b.annotation) for b in node.body if isinstance(b, ast.AnnAssign)]
            if any(d.startswith("dataclass") for d in made) and any(
                word in field for word in held for field in fields
            ):
                seen += 1
                if not any("eq=False" in d for d in made):
                    wrong.append(f"{path.relative_to(PACKAGE)}: {node.name}")
    assert seen > 20 and not wrong


def test_nonlinear_bodies_are_known_to_two_files():
    """As the page on the method says; Newton's iteration knows a protocol."""
    known = {p.name for p in PACKAGE.rglob("*.py") if "NonlinearBulk" in p.read_text()}
    assert known == {"nonlinear_bulk.py", "nonlinear.py"}


OWN = ("self", "cls")
THEIRS = {  # dolfinx's, which this one module knows
    "base/compat.py": {"_cpp_object", "_ufl_coordinate_element"},
}


def private_reads(tree):
    """Names with an underscore that are read from another object than ``self``, and imported."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and not node.attr.endswith("__"):
            named = isinstance(node.value, ast.Name) and node.value.id in OWN
            parent = isinstance(node.value, ast.Call) and ast.unparse(node.value.func) == "super"
            if node.attr.startswith("_") and not named and not parent:
                yield node.attr, node.lineno
        elif isinstance(node, ast.ImportFrom):
            names = [alias.name for alias in node.names]
            yield from ((name, node.lineno) for name in names if name.startswith("_"))


def test_private_names_stay_private():
    wrong = []
    for path in sorted(PACKAGE.rglob("*.py")):
        place = path.relative_to(PACKAGE).as_posix()
        for name, line in private_reads(ast.parse(path.read_text())):
            if name not in THEIRS.get(place, ()):
                wrong.append(f"{place}:{line} reads {name}")
    assert not wrong


def test_private_reads_are_found():
    source = "a._b\nself._c\nsuper()._d\ncls._e\na.__class__\nself._f._g\nfrom h import _i, j"
    assert [name for name, _ in private_reads(ast.parse(source))] == ["_i", "_b", "_g"]


def test_modules_are_small():
    """At most 300 lines."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        if len(path.read_text().splitlines()) > 300:
            found.add(path.relative_to(PACKAGE).as_posix())
    assert not found


def constants(tree):
    """Names in capitals that a module defines."""
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else []
        for target in targets:
            for name in target.elts if isinstance(target, ast.Tuple) else [target]:
                if isinstance(name, ast.Name) and name.id.isupper():
                    yield name.id.lstrip("_")


SAME = {"EPS"}  # one number, wherever it stands


def test_a_constant_has_one_meaning():
    """No name in capitals is defined in two modules."""
    found = [
        c for path in PACKAGE.rglob("*.py") for c in set(constants(ast.parse(path.read_text())))
    ]
    twice = {name for name in found if found.count(name) > 1}
    assert len(found) > 80 and not twice - SAME


def test_classes_are_small():
    """At most 200 lines."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef) and node.end_lineno - node.lineno >= 200:
                found.add(node.name)
    assert not found
