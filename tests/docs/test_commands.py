"""The commands of the documents exist: names, options, problems, parameters."""

from __future__ import annotations

import importlib.util
import itertools
import re
import shlex
from pathlib import Path

import click
import pytest

from scripts.measure.__main__ import main as measure
from tests.support.repository import ROOT
from trajopt.cli.commands import main
from trajopt.problem.catalogue import families

DOCUMENTS = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
LINE = re.compile(r"^ *(?:\$ )?(?:uv run )?trajopt ((?:[a-z]+)(?: .*)?)$", re.MULTILINE)
SCRIPT = re.compile(r"python -m scripts\.(\w+)([^`\n]*)")
OF_A_PROBLEM = ("solve", "continue", "sweep", "reference")
WRONG = ("solo12-jmp",)  # on purpose, to show the message


def commands(document: Path) -> list[list[str]]:
    """Words of every command line of a document, without comments and what follows in a shell."""
    text = re.sub(r"\\\n", " ", document.read_text(encoding="utf-8"))
    found = []
    for line in LINE.findall(text):
        words = shlex.split(re.split(r" \|\|? | && | > | 2>|; ", line)[0], comments=True)
        if not (set(words) & {"...", "is", "are"}):  # prose, or a pattern of a command
            found.append(words)
    return found


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_commands_and_their_options_exist(document: Path) -> None:
    for words in commands(document):
        command = main.get_command(click.Context(main), words[0])
        assert command is not None, " ".join(words)
        options = {name for option in command.params for name in (*option.opts, *option.secondary_opts)}
        given = {word.split("=")[0] for word in words[1:] if re.match(r"--?[a-zA-Z]", word)}
        assert given <= options | {"--help", "-h"}, " ".join(words)


def test_scripts_and_their_options_exist() -> None:
    found = [entry for document in DOCUMENTS for entry in SCRIPT.findall(document.read_text("utf-8"))]
    assert "measure" in {name for name, _ in found}
    for name, rest in found:
        assert importlib.util.find_spec(f"scripts.{name}"), name
        words = shlex.split(rest, comments=True)
        if name != "measure" or words == ["--help"]:
            continue
        assert words[0] in measure.commands, rest
        options = {option for parameter in measure.commands[words[0]].params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= options, rest


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_problems_and_their_parameters_exist(document: Path) -> None:
    known = families()
    for words in commands(document):
        if words[0] not in OF_A_PROBLEM or words[1].isupper() or words[1] in WRONG:
            continue
        assert words[1] in known, " ".join(words)
        settings = [after for word, after in itertools.pairwise(words) if word == "--set"]
        names = {setting.split("=")[0] for setting in settings}
        assert names <= {parameter.name for parameter in known[words[1]].parameters}, " ".join(words)


def test_there_are_commands_in_the_readme() -> None:
    found = {words[0] for words in commands(ROOT / "README.md")}
    assert found >= {"solve", "replay", "render", "plot", "simulate", "check", "suite"}
