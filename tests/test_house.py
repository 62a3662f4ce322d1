"""The tests' own house: test files stand alone, and every room of the library has its tests."""

import ast
import re
from pathlib import Path

from tests.support.repository import ROOT

TESTS = ROOT / "tests"
# `from trajopt.ROOM.MODULE import NAMES`, in code and in blocks of documents.
IMPORTS = re.compile(r"^\s*from (trajopt\.[\w.]+) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
SELDOM = re.compile(r"mark\.(long|slow)")
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


def test_every_room_has_quick_tests():
    """Files that are not ``long`` or ``slow`` as a whole, with a test that is neither."""
    lacking = {folder.name for folder in TESTS.iterdir() if list(folder.glob("test_*.py"))}
    for path in TESTS.glob("*/test_*.py"):
        body = ast.parse(path.read_text(encoding="utf-8")).body
        marks = [ast.unparse(node) for node in body if isinstance(node, ast.Assign)]
        tests = [node for node in body if getattr(node, "name", "").startswith("test_")]
        alone = [
            [ast.unparse(mark) for mark in test.decorator_list if "parametrize" not in ast.unparse(mark)]
            for test in tests
        ]
        if not any(SELDOM.search(mark) for mark in marks if mark.startswith("pytestmark")):
            lacking -= {path.parent.name for marks in alone if not SELDOM.search(" ".join(marks))}
    assert lacking == set()


def test_no_public_name_of_a_room_is_also_one_of_its_modules():
    """`from trajopt.ROOM import NAME` would give the module once anything had imported that."""
    for stub in (ROOT / "trajopt").glob("**/__init__.pyi"):
        names = set(re.findall(r" as (\w+)$", stub.read_text(encoding="utf-8"), re.MULTILINE))
        modules = {path.stem for path in stub.parent.iterdir() if path.suffix in {"", ".py"}}
        if stub.parent.name == "trajopt":
            names -= {"robot"}  # the package can be called
        assert not names & modules, stub


def test_problems_and_documents_import_public_names_from_the_rooms():
    """A user who reads them finds names where `trajopt.ROOM` offers them, not in modules."""
    public = {
        name: f"trajopt.{stub.parent.name}"
        for stub in (ROOT / "trajopt").glob("*/__init__.pyi")
        for name in re.findall(r" as (\w+)$", stub.read_text(encoding="utf-8"), re.MULTILINE)
    }
    read = [*(ROOT / "problems").glob("*.py"), *(ROOT / "docs").rglob("*.md"), ROOT / "README.md"]
    found = {
        f"{path.relative_to(ROOT)} imports {name} from {module}, not from {public[name]}"
        for path in read
        for module, names in IMPORTS.findall(path.read_text(encoding="utf-8"))
        for name in re.split(r"[\s,()]+", names)
        if name in public and module.startswith(public[name] + ".")
    }
    assert found == set()
