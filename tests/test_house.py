"""The tests' own house: test files stand alone, and every room of the library has its tests."""

from __future__ import annotations

import ast
from pathlib import Path

from tests.support.repository import ROOT

TESTS = ROOT / "tests"
ROOMS = {path.parent.name for path in (ROOT / "trajopt").glob("*/__init__.py")}


def imported(path: Path) -> set[str]:
    """Dotted names of what a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{name.name}" for name in node.names}
    return found


def test_no_file_imports_a_test_file():
    """What two of them need is in `tests.support`, or a fixture in a ``conftest.py``."""
    found = {
        f"{path.relative_to(ROOT)} imports {name}"
        for path in TESTS.rglob("*.py")
        for name in imported(path)
        if name.startswith("tests.") and any(part.startswith("test_") for part in name.split("."))
    }
    assert found == set()


def test_every_room_has_a_folder_of_tests():
    assert {room for room in ROOMS if not list((TESTS / room).glob("test_*.py"))} == set()
