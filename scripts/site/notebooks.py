"""Notebooks as pages: executed, pictures and replays as files beside the page."""

import html
import re
import tempfile
from functools import partial
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbformat import NotebookNode

from scripts.site.stored import stored

FOLDER = "tutorials"
# Seconds for one cell.
LIMIT = 600
FRAME = re.compile(r'<iframe srcdoc="([^"]*)"[^>]*></iframe>')


def executed(path: Path) -> NotebookNode:
    """A notebook with its outputs."""
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=LIMIT, resources={"metadata": {"path": folder}}).execute()
    return notebook


def pages(path: Path) -> dict[str, bytes]:
    """Files of the site by path: the executed notebook as Markdown, its pictures and its replays."""
    from nbconvert import MarkdownExporter  # which tests do without

    name = path.stem
    notebook = stored(name, partial(executed, path), path)
    found: dict[str, bytes] = {}
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            _frame_as_file(output, name, found)
    text, resources = MarkdownExporter().from_notebook_node(
        notebook, {"unique_key": name, "output_files_dir": name}
    )
    found |= {f"{FOLDER}/{file}": data for file, data in resources.get("outputs", {}).items()}
    return {**found, f"{FOLDER}/{name}.md": text.replace("](../docs/", "](../").encode()}


def _frame_as_file(output: NotebookNode, name: str, found: dict[str, bytes]) -> None:
    """Put the page that an output holds as text into a file, and a frame that shows it in its place."""
    frame = FRAME.search(output.get("data", {}).get("text/html", ""))
    if frame is None:
        return
    file = f"{name}/replay-{len(found)}.html"
    found[f"{FOLDER}/{file}"] = html.unescape(frame[1]).encode()
    output["data"]["text/html"] = f'<iframe class="replay" src="{file}" loading="lazy"></iframe>'
