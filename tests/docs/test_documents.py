"""The Python of the documents runs, and what it solves is solved and passes the check."""

import ast
import importlib
import pkgutil
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import trajopt
from tests.support.pages import ANY_BLOCK, PAGES
from tests.support.printed import difference
from tests.support.processes import environment
from tests.support.repository import ROOT

NOT_OURS = {"puppy.py", "paw.py"}  # files that a reader makes
SOURCES = ("trajopt", "problems", "robots", "scripts", "tests", "docs")
# Packages of this repository that documents import from.
OURS = ("trajopt", "trajopt_library")
BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
# Blocks whose workers import the script: only a script of its own shows that they have a main guard.
STARTS_WORKERS = re.compile(r"trajopt\.(?:batch|discover)\(")
# What a block prints, where a document says so directly below it.
OUTPUT = re.compile(r"^```python\n(.*?)^```\n(?:\n```output\n(.*?)^```$)?", re.DOTALL | re.MULTILINE)


def blocks(document: str) -> list[str]:
    """The Python blocks of a document, in order."""
    return BLOCK.findall((ROOT / document).read_text(encoding="utf-8"))


DOCUMENTS = [str(path.relative_to(ROOT)) for path in PAGES]
# Examples that pages show whole, which `test_examples.py` runs.
EXAMPLES = {path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "examples").glob("*.py")}
ALL = [(page, index) for page in DOCUMENTS for index, text in enumerate(blocks(page)) if text not in EXAMPLES]


def test_there_are_python_blocks_to_run() -> None:
    assert {"README.md", "docs/index.md", "docs/getting-started.md", "docs/robots.md"} <= {d for d, _ in ALL}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_names_that_python_blocks_import_exist(page: Path) -> None:
    for block in ANY_BLOCK.findall(page.read_text(encoding="utf-8")):
        for node in ast.walk(ast.parse(textwrap.dedent(block))):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] in OURS:
                module = importlib.import_module(node.module)
                found = {name.name: hasattr(module, name.name) for name in node.names}
                modules = {each.name for each in pkgutil.iter_modules(getattr(module, "__path__", []))}
                missing = [name for name, known in found.items() if not known and name not in modules]
                assert missing == [], f"{node.module} has no {missing}"
            named = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
            if named and node.value.id == "trajopt":
                assert hasattr(trajopt, node.attr), f"trajopt.{node.attr}"


@pytest.mark.parametrize("document", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_source_files_that_documents_name_exist(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    named = set(re.findall(r"`([\w/]+\.(?:py|cpp|hpp))`", text)) - NOT_OURS
    sources = [path for folder in SOURCES for path in (ROOT / folder).rglob("*.*")]
    missing = {name for name in named if not any(path.as_posix().endswith("/" + name) for path in sources)}
    assert missing == set()


@pytest.mark.slow
@pytest.mark.parametrize(("document", "index"), ALL)
def test_python_block_runs(
    document: str,
    index: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    if STARTS_WORKERS.search(blocks(document)[index]):
        script = tmp_path / "script.py"
        script.write_text(blocks(document)[index], encoding="utf-8")
        ended = subprocess.run(
            [sys.executable, str(script)], capture_output=True, text=True, env=environment()
        )
        assert ended.returncode == 0, ended.stderr
        return
    namespace: dict[str, object] = {"__name__": "__main__"}
    exec(compile(blocks(document)[index], f"{document}, block {index}", "exec"), namespace)
    stated = OUTPUT.findall((ROOT / document).read_text(encoding="utf-8"))[index][1]
    if stated:
        assert difference(stated, capsys.readouterr().out) == ""
    if "solution" in namespace:
        assert namespace["solution"].statistics.status == "solved"
        report = namespace.get("report") or trajopt.check(namespace["solution"])
        assert report.failures() == ()
        assert list(tmp_path.glob("*.npz"))
