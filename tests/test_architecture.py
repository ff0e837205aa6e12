"""The rooms of the package: what may import what."""

import ast
from pathlib import Path

import dolfinx_llm

PACKAGE = Path(dolfinx_llm.__file__).parent
# From the ground up: a package imports those before it, never one after.
ROOMS = (
    "base", "geometry", "laws", "design", "interface", "operators", "forms", "contact", "output",
    "problem",
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
