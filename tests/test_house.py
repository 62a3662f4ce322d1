"""The tests' own house: test files stand alone, and what they share is in `tests.support`."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tests.support.repository import ROOT

MODULES = sorted((ROOT / "tests").rglob("*.py"))
ROOMS = {path.name for path in (ROOT / "trajopt").iterdir() if (path / "__init__.py").exists()}


def imported(path: Path) -> set[str]:
    """Dotted names of the modules, or of names in them, that a file imports anywhere."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{name.name}" for name in node.names}
    return found


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_file_imports_a_test_file(path: Path):
    modules = {".".join(other.relative_to(ROOT).with_suffix("").parts) for other in MODULES}
    tests = {name for name in modules if name.rpartition(".")[2].startswith("test_")}
    ours = {name for name in imported(path) if name.split(".")[0] == "tests"}
    assert {name for name in ours if name in tests or name.rpartition(".")[0] in tests} == set()


def test_every_room_has_a_folder_of_tests():
    assert {room for room in ROOMS if not list((ROOT / "tests" / room).glob("test_*.py"))} == set()
