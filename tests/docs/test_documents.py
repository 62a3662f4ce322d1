"""Documents: their Python runs, their commands exist, and the tutorial prints what it shows."""

import ast
import importlib
import importlib.util
import itertools
import math
import os
import pkgutil
import re
import shlex
import subprocess
import sys
import textwrap
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import click
import pytest

import trajopt
from scripts.measure.__main__ import main as measure
from tests.support.pages import ANY_BLOCK, PAGES
from tests.support.printed import difference
from tests.support.processes import LIMIT, environment
from tests.support.repository import ROOT
from trajopt.cli.commands import main
from trajopt.problem.catalogue import families

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
# Examples that pages show whole, which `test_notebooks.py` runs.
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


COMMANDS_DOCUMENTS = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
LINE = re.compile(r"^ *(?:\$ )?(?:uv run (?:--\w+ \S+ )*)?trajopt ((?:[a-z]+)(?: .*)?)$", re.MULTILINE)
# A command within a sentence is complete if it has an argument or an option.
WITHIN = re.compile(r"`(?:uv run )?trajopt ([a-z]+ [^`\n]*)`")
SCRIPT = re.compile(r"python -m scripts\.(\w+)([^`\n]*)")
OF_A_PROBLEM = ("solve", "continue", "sweep", "reference")
# On purpose, to show the message; and the problem that CONTRIBUTING.md adds.
WRONG = ("solo12-jmp", "arm-raise")


def commands(document: Path) -> list[list[str]]:
    """Words of every command line of a document, without comments and what follows in a shell."""
    text = re.sub(r"\\\n", " ", document.read_text(encoding="utf-8"))
    found = []
    for line in [*LINE.findall(text), *WITHIN.findall(text)]:
        words = shlex.split(re.split(r" \|\|? | && | > | 2>|; ", line)[0], comments=True)
        if not (set(words) & {"...", "is", "are"}):  # prose, or a pattern of a command
            found.append(words)
    return found


def named(words: list[str]) -> tuple[click.Command, click.Context, list[str]]:
    """The command that words name, of a group its member, its context, and the words after its name."""
    command: click.Command = main
    context = click.Context(main, info_name="trajopt")
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        found = command.get_command(context, words[0])
        assert found is not None, f"no command {words[0]} of {context.command_path}"
        command, context = found, click.Context(found, info_name=words[0], parent=context)
        words = words[1:]
    return command, context, words


@pytest.mark.parametrize("document", COMMANDS_DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_commands_are_accepted_by_the_parser_of_the_command_line(
    document: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names, options, numbers of arguments, choices and numbers; files need not exist."""
    for kind in (click.Path, click.File):
        monkeypatch.setattr(kind, "convert", lambda self, value, parameter, context: value)
    for words in commands(document):
        command, context, rest = named(words)
        mentioned = not rest and context.parent is not None and context.parent.info_name == "bench"
        if {"--help", "-h"} & set(rest) or isinstance(command, click.Group) or mentioned:
            continue
        if rest and rest[0].startswith("-"):  # a sentence about an option
            options = {name for option in command.params for name in (*option.opts, *option.secondary_opts)}
            assert rest[0].split("=")[0] in options, " ".join(words)
            continue
        try:
            command.make_context(context.info_name, list(rest), parent=context.parent)
        except click.ClickException as error:
            pytest.fail(f"trajopt {' '.join(words)}: {error.format_message()}")


def test_scripts_and_their_options_exist() -> None:
    found = [
        entry for document in COMMANDS_DOCUMENTS for entry in SCRIPT.findall(document.read_text("utf-8"))
    ]
    assert "measure" in {name for name, _ in found}
    for name, rest in found:
        assert importlib.util.find_spec(f"scripts.{name}"), name
        words = shlex.split(rest, comments=True)
        if name != "measure" or words == ["--help"]:
            continue
        assert words[0] in measure.commands, rest
        options = {option for parameter in measure.commands[words[0]].params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= options, rest


@pytest.mark.parametrize("document", COMMANDS_DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_problems_and_their_parameters_exist(document: Path) -> None:
    known = families()
    for line in commands(document):
        words = line[1:] if line[0] == "bench" else line
        if (
            len(words) < 2
            or words[0] not in OF_A_PROBLEM
            or words[1].isupper()
            or words[1].startswith("-")
            or words[1] in WRONG
        ):
            continue
        assert words[1] in known, " ".join(words)
        settings = [after for word, after in itertools.pairwise(words) if word == "--set"]
        names = {setting.split("=")[0] for setting in settings}
        assert names <= {parameter.name for parameter in known[words[1]].parameters}, " ".join(words)


def test_there_are_commands_in_the_readme() -> None:
    found = {words[0] for words in commands(ROOT / "README.md")}
    assert found >= {"solve", "replay", "render", "plot", "simulate", "check", "bench"}


TUTORIAL = ROOT / "docs" / "tutorial" / "bring-your-own-robot.md"
TUTORIAL_BLOCK = re.compile(r"^```(\w+) ?([\w.]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"-?\d+\.?\d*(?:e[+-]?\d+)?")
# Counts and times that differ from one machine to another.
FREE_UNITS = ("s", "ms", "iterations", "MB")
# Of what is optimised three digits are shared by all machines; below this it is rounding.
RELATIVE, ROUNDING = 0.02, 1e-5


@dataclass(frozen=True)
class Block:
    """A block of the tutorial: its language, the file that its text is saved as, and the text."""

    language: str
    file: str
    text: str


def tutorial_blocks() -> list[Block]:
    return [Block(*found) for found in TUTORIAL_BLOCK.findall(TUTORIAL.read_text(encoding="utf-8"))]


def same(shown: str, printed: str) -> bool:
    """Whether a printed line is the shown one but for digits; ``...`` at its end stands for anything."""
    if shown.strip().endswith("..."):
        words = shown.split()[:-1]
        return same(" ".join(words), " ".join(printed.split()[: len(words)]))
    ours, theirs = shown.split(), printed.split()
    if len(ours) != len(theirs):
        return False
    following = [*ours[1:], ""]
    return all(_same_word(*words) for words in zip(ours, theirs, following, strict=True))


def _same_word(shown: str, printed: str, following: str) -> bool:
    if shown == printed:
        return True
    if NUMBER.sub("#", shown) != NUMBER.sub("#", printed):
        return False
    if following.strip(":;,") in FREE_UNITS:
        return True
    pairs = zip(NUMBER.findall(shown), NUMBER.findall(printed), strict=True)
    return all(math.isclose(float(a), float(b), rel_tol=RELATIVE, abs_tol=ROUNDING) for a, b in pairs)


def missing(shown: str, printed: str) -> list[str]:
    """Lines that are shown and not printed, in their order; a line ``...`` stands for any number of them."""
    left, lost = printed.splitlines(), []
    for line in shown.splitlines():
        if line.strip() == "...":
            continue
        place = next((index for index, entry in enumerate(left) if same(line, entry)), None)
        if place is None:
            lost.append(line)
        else:
            left = left[place + 1 :]
    return lost


def run(script: str, folder: Path) -> str:
    """What a shell block prints; as in the tutorial, the environment is active and the clone is known."""
    tools = str(Path(sys.executable).parent)
    environment = os.environ | {"TRAJOPT": str(ROOT), "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}"}
    command = ["bash", "-euo", "pipefail", "-c", script]
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    done = subprocess.run(command, cwd=folder, env=environment, text=True, timeout=LIMIT, **both)
    assert done.returncode == 0, f"{script}\n{done.stdout}"
    return done.stdout


def test_a_line_is_compared_but_for_digits_that_differ_between_machines() -> None:
    assert same("solved; ipopt, 16 iterations", "solved;  ipopt, 17 iterations")
    assert same("objective  0.3595", "objective 0.359507")
    assert not same("objective  0.3595", "objective 0.4")
    assert same("jump.html: 1.14 s, 0.4 MB", "jump.html: 1.14 s, 1.2 MB")
    assert not same("tracked", "not tracked")
    assert same("  worst      ...", "  worst      defect in phase 'flight'")
    assert missing("a\n...\nc", "a\nb\nc") == []
    assert missing("c\na", "a\nb\nc") == ["a"]


def test_output_follows_what_prints_it() -> None:
    kinds = [block.language for block in tutorial_blocks()]
    assert set(kinds) == {"sh", "text", "python"}
    assert all(before == "sh" for before, kind in pairwise(kinds) if kind == "text")
    assert all(block.file.endswith(".py") for block in tutorial_blocks() if block.language == "python")


@pytest.mark.slow
def test_tutorial_followed_literally(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    printed = ""
    for block in tutorial_blocks():
        if block.language == "python":
            (tmp_path / block.file).write_text(block.text, encoding="utf-8")
        elif block.language == "sh":
            printed = run(block.text, tmp_path)
        else:
            assert missing(block.text, printed) == [], printed
    pages = {path.name for path in tmp_path.glob("*.html")}
    assert pages == {"puppy.html", "both.html", "jump.html", "paw.html"}
    for page in pages:
        text = (tmp_path / page).read_text(encoding="utf-8")
        assert "http-equiv" in text
        assert "puppy" in text
