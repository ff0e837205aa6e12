"""Builds the API documentation from the docstrings with pdoc: .ci/docs.py FOLDER

Fields of records are described by a comment behind each, which pdoc does not read: their classes
get an Attributes section from these comments. Any warning ends the build.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import io
import os
import re
import sys
import tokenize
import warnings
from pathlib import Path

# What users call or get back. "compat" and the rest are the developers'.
MODULES = {
    "dolfinx_llm": None,  # with SUBMODULES
    "dolfinx_llm.problem": (),  # pages that stand beside the code
    "dolfinx_llm.base": (),
    "dolfinx_llm.finite.results": ("MovingInterfaceResult", "MovingSideResult"),
    "dolfinx_llm.contact.results.results": ("InterfaceResult", "SideResult"),
    "dolfinx_llm.geometry.frame": ("Frame", "Quality"),
    "dolfinx_llm.geometry.location": ("Location",),
    "dolfinx_llm.interface.choices": ("Interface",),
    "dolfinx_llm.interface.join": ("Certificate",),
    "dolfinx_llm.interface.geometry": ("InterfaceGeometry",),
    "dolfinx_llm.geometry.pairs": ("ContactPairs",),
}
SUBMODULES = ("dolfinx_llm.classical", "dolfinx_llm.plot", "dolfinx_llm.post")


def field_comments(cls: type) -> dict[str, str]:
    """Comments behind the fields of a dataclass, or those that stand on lines of their own before
    them, by name."""
    source = inspect.cleandoc("\n" + inspect.getsource(cls))
    comments: dict[str, str] = {}
    names = {field.name for field in dataclasses.fields(cls)}
    line, above = [], []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            text = token.string.lstrip("# ")
            (above if not line else line).append(text)
        elif token.type == tokenize.NEWLINE:
            if line and line[0] in names and (above or line[-1] is not line[0]):
                comments[line[0]] = " ".join(above + line[1:])
            line, above = [], []
        elif token.type == tokenize.NAME and not line:
            line.append(token.string)
    return comments


def describe_fields(cls: type) -> None:
    """Append the comments of a dataclass's fields to its docstring."""
    comments = field_comments(cls)
    if comments:
        lines = [f"    {name}: {text}" for name, text in comments.items()]
        cls.__doc__ = "\n".join([inspect.getdoc(cls) or "", "", "Attributes:", *lines])


def is_own_record(item: object) -> bool:
    own = inspect.isclass(item) and item.__module__.startswith("dolfinx_llm")
    return own and dataclasses.is_dataclass(item)


def build(folder: Path) -> None:
    import pdoc
    import pdoc.render

    records = set()
    for name in (*MODULES, *SUBMODULES):
        module = importlib.import_module(name)
        if MODULES.get(name):
            module.__all__ = list(MODULES[name])
        names = MODULES.get(name) or getattr(module, "__all__", vars(module))
        records |= {item for item in map(vars(module).get, names) if is_own_record(item)}
    for cls in records:
        describe_fields(cls)
    pdoc.render.configure(docformat="google", math=False, mermaid=True)
    pdoc.pdoc(*MODULES, output_directory=folder)
    for page in folder.glob("dolfinx_llm/*.html"):  # pages included there link to their neighbours
        beside = page.relative_to(folder / "dolfinx_llm").with_suffix("")
        page.write_text(
            re.sub(
                r'href="([^":]+)\.md',
                lambda link, beside=beside: f'href="{os.path.normpath(beside / link[1])}.html',
                page.read_text(),
            )
        )


if __name__ == "__main__":
    warnings.simplefilter("error")
    build(Path(sys.argv[1]))
