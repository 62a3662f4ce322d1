"""The tests' own house: test files stand alone, and every room of the library has its tests."""

import re

from tests.support.repository import ROOT

TESTS = ROOT / "tests"
# `from trajopt.ROOM.MODULE import NAMES`, in code and in blocks of documents.
IMPORTS = re.compile(r"^\s*from (trajopt\.[\w.]+) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
# What a whole file is marked with, the marks above a test, and those of what is not quick.
SELDOM_FILE = re.compile(r"^pytestmark = .*mark\.(long|slow)", re.MULTILINE)
MARKS = re.compile(r"((?:^@pytest\.mark\.\w+\n)*)^def test_", re.MULTILINE)
SELDOM = re.compile(r"mark\.(long|slow)")
OURS = re.compile(r"^\s*(?:import tests|from (?:tests|\.)[\w.]* import (?:\([^)]*\)|.*)).*", re.MULTILINE)
ROOMS = {path.parent.name for path in (ROOT / "trajopt").glob("*/__init__.py")}


def test_no_file_imports_a_test_file():
    """What two of them need is in `tests.support`, or a fixture in a ``conftest.py``."""
    found = {
        f"{path.relative_to(ROOT)}: {statement}"
        for path in TESTS.rglob("*.py")
        for statement in OURS.findall(path.read_text(encoding="utf-8"))
        if set(re.findall(r"\btest_\w+", statement)) - {path.stem}
    }
    assert found == set()


def test_every_room_has_a_folder_of_tests():
    assert {room for room in ROOMS if not list((TESTS / room).glob("test_*.py"))} == set()


def test_every_room_has_quick_tests():
    """A file that is not ``long`` or ``slow`` as a whole, with a test that is neither."""
    lacking = {folder.name for folder in TESTS.iterdir() if list(folder.glob("test_*.py"))}
    for path in TESTS.glob("*/test_*.py"):
        text = path.read_text(encoding="utf-8")
        if SELDOM_FILE.search(text) is None and any(
            not SELDOM.search(marks) for marks in MARKS.findall(text)
        ):
            lacking.discard(path.parent.name)
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
