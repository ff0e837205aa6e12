"""The demos as pages: .ci/gallery.py run [NAME ... | PART/PARTS] | pages FOLDER

``run`` runs the demos, each in build/gallery/NAME, and keeps there pictures, what was printed, and
what it took. ``pages`` writes to FOLDER a page for every demo, of its docstring, its code and what
was kept, pages of all Markdown files, and an index with a picture of each demo.
"""

from __future__ import annotations

import ast
import html
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "build" / "gallery"
# What demos are run with; those that are not named, with --plot and the folder.
OPTIONS = {
    "error_vs_time": "--quick --scenes manufactured 'dragged block' --output .",
    "ironing": "--mu 0 0.3 --steps 14 --plot .",
    "rubber_seal": "--refine 2 --plot .",
    "scale": "--largest 10000 --plot .",
    "second_order": "--cells 8 16 32 --elements 4 8 --plot .",
    "solvers": "--only GAMG --largest 8500 --repeat 1 --plot .",  # 60000: README's figures
    "stiff_cases": "--size 4 --plot .",
    "tutorial": "",
    "turned_strips": "--step 30 --plot .",
}
SHOWN = 8  # pictures of a demo on its page
SECONDS = 400.0  # that a demo may take
WORKERS = 2  # demos at a time
STYLE = """
body { max-width: 62rem; margin: 2rem auto; padding: 0 1rem; font: 16px/1.5 sans-serif; }
pre { overflow: auto; padding: .7rem; background: #f6f8fa; font-size: 13px; max-height: 40rem; }
img { max-width: 100%; } table { border-collapse: collapse; }
td, th { border: 1px solid #ccc; padding: .25rem .5rem; text-align: left; vertical-align: top; }
.demos { display: grid; grid-template-columns: repeat(3, 1fr); gap: 1.2rem; }
.demos a { color: inherit; text-decoration: none; }
.demos img { height: 9rem; object-fit: contain; }
"""


def demos() -> dict[str, str]:
    """Names of the demos to their docstrings; a module without a ``main`` is none."""
    found = {}
    for path in sorted((ROOT / "demos").glob("*.py")):
        tree = ast.parse(path.read_text())
        if any(isinstance(node, ast.FunctionDef) and node.name == "main" for node in tree.body):
            found[path.stem] = ast.get_docstring(tree) or ""
    return found


def chosen(words: list[str]) -> list[str]:
    """Demos by name, or of a part such as 0/3, in turn; none given: all."""
    every = list(demos())
    if len(words) == 1 and "/" in words[0]:
        part, parts = map(int, words[0].split("/"))
        return every[part::parts]
    return words or every


# ## Running
def run(name: str) -> str:
    """Run a demo in a folder of its own, keep what it shows, and tell how long it took."""
    folder = KEPT / name
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    options = OPTIONS.get(name, "--plot .")
    words = [sys.executable, str(ROOT / "demos" / f"{name}.py"), *shlex.split(options)]
    began = time.perf_counter()
    environment = {"OMP_NUM_THREADS": "1", **os.environ}
    done = subprocess.run(
        words, cwd=folder, env=environment, capture_output=True, text=True, timeout=SECONDS
    )
    if done.returncode:
        raise SystemExit(f"{name} failed\n{done.stdout[-2000:]}{done.stderr[-4000:]}")
    seconds = time.perf_counter() - began
    command = f"python demos/{name}.py {options}".strip()
    (folder / "printed.txt").write_text(done.stdout)
    (folder / "run.json").write_text(json.dumps({"command": command, "seconds": seconds}) + "\n")
    return f"{name:20} {seconds:6.1f} s, {len(pictures(name))} picture(s)"


def pictures(name: str) -> list[Path]:
    """What a run has drawn, that of the bodies first."""
    found = sorted((KEPT / name).rglob("*.png"))
    return sorted(found, key=lambda path: path.name != "bodies.png")


# ## Pages
def page(path: Path, title: str, body: str, up: str) -> None:
    """Write a page; ``up`` leads from its folder to the index's."""
    links = (
        f'<p><a href="{up}index.html">dolfinx_llm</a> · <a href="{up}demos/index.html">demos</a>'
    )
    links += f' · <a href="{up}dolfinx_llm.html">all public names</a></p>'
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}'
        f"</title><style>{STYLE}</style></head>\n<body><p>{links}</p>\n{body}\n</body></html>\n"
    )


def rendered(markdown: str) -> str:
    import markdown2

    return markdown2.markdown(markdown, extras=["tables", "fenced-code-blocks", "header-ids"])


def demo_page(name: str, text: str, folder: Path) -> None:
    """Text, pictures, numbers and code of a demo."""
    from pygments import highlight
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import PythonLexer

    kept, parts = KEPT / name, [f"<h1>{name}</h1>", rendered(text)]
    if (kept / "run.json").exists():
        told = json.loads((kept / "run.json").read_text())
        parts.append(f"<h2>What a run gave</h2><pre>{html.escape(told['command'])}</pre>")
        for picture in pictures(name)[:SHOWN]:
            copied = f"{name}_{picture.name}"
            (folder / "demos").mkdir(parents=True, exist_ok=True)
            shutil.copy(picture, folder / "demos" / copied)
            parts.append(f'<img src="{copied}" alt="{picture.stem} of {name}">')
        printed = html.escape((kept / "printed.txt").read_text().strip())
        parts.append(f"<pre>{printed}</pre><p>In {told['seconds']:.0f} s.</p>")
    else:
        parts.append("<p>Pictures and numbers: <code>make gallery</code>, then this page anew.</p>")
    source = (ROOT / "demos" / f"{name}.py").read_text().partition('"""\n\n')[2]
    formatter = HtmlFormatter(noclasses=True)
    parts += ["<h2>Code</h2>", highlight(source, PythonLexer(), formatter)]
    page(folder / "demos" / f"{name}.html", name, "\n".join(parts), "../")


def gallery(folder: Path) -> None:
    """Pages of the demos, and their index."""
    cards = []
    for name, text in demos().items():
        demo_page(name, text, folder)
        first, shown = text.partition("\n\n")[0].replace("\n", " "), pictures(name)
        drawn = f'<img src="{name}_{shown[0].name}" alt="">' if shown else ""
        cards.append(f'<a href="{name}.html">{drawn}<br><b>{name}</b><br>{html.escape(first)}</a>')
    body = '<h1>Demos</h1><p><a href="README.html">All figures, and what they say</a></p>'
    body += f'<div class="demos">{"".join(cards)}</div>'
    page(folder / "demos" / "index.html", "Demos", body, "../")


def markdown_pages(folder: Path) -> None:
    """The Markdown files, with README as the index; their links lead to each other."""
    for path in (ROOT / "README.md", ROOT / "demos/README.md", *ROOT.glob("dolfinx_llm/**/*.md")):
        place = path.relative_to(ROOT)
        target = folder / (
            "index.html" if place == Path("README.md") else place.with_suffix(".html")
        )
        text = path.read_text()
        for link in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text):
            copied = folder / place.parent / link
            copied.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path.parent / link, copied)
        text = re.sub(r"\]\(([^)#:]+)\.md(#[^)]*)?\)", r"](\1.html\2)", text)
        page(
            target,
            text.partition("\n")[0].strip("# "),
            rendered(text),
            "../" * (len(place.parts) - 1),
        )


def dead_links(folder: Path) -> list[str]:
    """Links of all pages to files that are not there."""
    return [
        f"{path.relative_to(folder)}: {link}"
        for path in folder.rglob("*.html")
        for link in re.findall(r'(?:href|src)="([^"#:$]+)[#"]', path.read_text())
        if not (path.parent / link).exists()
    ]


def main(arguments: list[str]) -> None:
    if arguments[0] == "run":
        with ThreadPoolExecutor(WORKERS) as workers:
            for told in workers.map(run, chosen(arguments[1:])):
                print(told, flush=True)
    else:
        gallery(Path(arguments[1]))
        markdown_pages(Path(arguments[1]))
        whole = Path(arguments[1], "dolfinx_llm.html").exists()  # with the pages of the API
        if whole and (dead := dead_links(Path(arguments[1]))):
            raise SystemExit("links that lead nowhere:\n" + "\n".join(dead))


if __name__ == "__main__":
    main(sys.argv[1:])
