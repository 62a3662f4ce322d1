"""The commands of the documents exist: names, options, problems, parameters."""

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

DOCUMENTS = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
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


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
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
