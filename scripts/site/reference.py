"""Pages of reference, from the code alone: one for each module with public names, one for each command."""

import ast
from collections.abc import Iterator
from pathlib import Path

import click

from trajopt.cli.commands import main
from trajopt.problem import Choice, Parameter, families

ROOT = Path(__file__).parents[2]
PYTHON, COMMANDS = "reference/python", "reference/commands"


def public_names() -> dict[str, tuple[str, ...]]:
    """Public names by module: those of the stubs ``__init__.pyi`` of the library and of its rooms."""
    stubs = [ROOT / "trajopt/__init__.pyi", *sorted((ROOT / "trajopt").glob("*/__init__.pyi"))]
    return {".".join(path.parent.relative_to(ROOT).parts): tuple(_exported(path)) for path in stubs}


def _exported(stub: Path) -> Iterator[str]:
    """Names that a stub exports and that are no packages of their own."""
    for node in ast.parse(stub.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            yield from (name.asname or name.name for name in node.names)


def _idea(module: str) -> str:
    """The first line of a package's docstring: its one idea."""
    source = ROOT / Path(*module.split("."), "__init__.py")
    text = ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""
    return text.splitlines()[0]


def python_pages() -> dict[str, str]:
    """Markdown by path: every public name with its docstring, which mkdocstrings takes from the code."""
    modules = public_names()
    pages = {f"{PYTHON}/{module}.md": _python_page(module, names) for module, names in modules.items()}
    rows = [
        f"| [`{module}`]({module}.md) | {_idea(module)} | "
        + ", ".join(f"[`{name}`]({module}.md#{module}.{name})" for name in sorted(names, key=str.lower))
        + " |"
        for module, names in modules.items()
    ]
    table = ["| module | idea | public names |", "|---|---|---|", *rows]
    head = [
        "# Python",
        "",
        "Every public name, from the code. A name is imported from the module that offers it here;"
        " modules below these are not public.",
        "",
    ]
    return {f"{PYTHON}/index.md": "\n".join(head + table) + "\n", **pages}


def _python_page(module: str, names: tuple[str, ...]) -> str:
    parts = [f"# `{module}`", _idea(module)]
    if module == "trajopt":
        parts.append(
            "`trajopt.robot(name)` loads a robot of the library: the room is a package that can be called."
        )
    return "\n\n".join([*parts, *(f"::: {module}.{name}" for name in names)]) + "\n"


def problem_page() -> dict[str, str]:
    """Markdown by path: every problem of the library with its parameters."""
    parts = [
        "# Problems",
        "Every problem of the library with its parameters, as `trajopt list PROBLEM` prints them."
        " What they do is described in the [library of motions](../problems/README.md).",
    ]
    for name, family in families().items():
        rows = [
            f"| `{own.name}` | {_default(own.default)} | {_range(own)} | {_cell(own.meaning)} |"
            for own in family.parameters
        ]
        table = ["| parameter | default | allowed | meaning |", "|---|---|---|---|", *rows]
        robots = ", ".join(family.robots)
        parts += [f"## `{name}`", f"{_cell(family.summary)}. Tested on {robots}.", "\n".join(table)]
    return {"reference/problems.md": "\n\n".join(parts) + "\n"}


def _default(value: float | str | None) -> str:
    return "derived" if value is None else f"{value:.4g}" if isinstance(value, float) else f"{value}"


def _range(own: Parameter | Choice) -> str:
    """Allowed values of a parameter in a few words."""
    if own.lower is None:
        return ", ".join(f"`{choice}`" for choice in own.choices)
    return f"{own.lower:.4g} to {own.upper:.4g} {own.unit}".strip()


def commands(group: click.Group = main, prefix: str = "trajopt") -> Iterator[tuple[str, click.Command]]:
    """Every command with its full name, groups before their members."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if command is None or command.hidden:
            continue
        yield f"{prefix} {name}", command
        if isinstance(command, click.Group):
            yield from commands(command, f"{prefix} {name}")


def command_pages() -> dict[str, str]:
    """Markdown by path: every command with its arguments and options, as click has them."""
    found = list(commands())
    rows = [
        f"| [`{name}`]({_file(name)}) | {_cell(command.get_short_help_str(200))} |" for name, command in found
    ]
    index = [
        "# Command line",
        "",
        "`trajopt` and `python -m trajopt` are the same. Exit status: 0 done; 1 ran but not solved, or not"
        " within tolerance; 2 bad input, with one line on stderr; 130 cancelled by Ctrl-C.",
        "",
        "| command | what it does |",
        "|---|---|",
        *rows,
    ]
    pages = {f"{COMMANDS}/{_file(name)}": _command_page(name, command) for name, command in found}
    return {f"{COMMANDS}/index.md": "\n".join(index) + "\n", **pages}


def _file(name: str) -> str:
    return name.removeprefix("trajopt ").replace(" ", "-") + ".md"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("*", "\\*")


def _command_page(name: str, command: click.Command) -> str:
    """Usage, description and tables of one command, options under the headings of its ``--help``."""
    context = click.Context(command, info_name=name)
    usage = command.get_usage(context).removeprefix("Usage: ")
    parts = [f"# `{name}`", f"```text\n{usage}\n```"]
    parts += [_cell(text) for text in (command.help or "").replace("\b", "").split("\n\n") if text.strip()]
    rows = [record for option in command.get_params(context) if (record := _row(option, context)) is not None]
    if rows:
        parts.append("\n".join(["| option or argument | meaning |", "|---|---|", *rows]))
    if isinstance(command, click.Group):
        members = [f"- [`{entry}`]({_file(entry)})" for entry, _ in commands(command, name)]
        parts.append("\n".join(members))
    return "\n\n".join(parts) + "\n"


def _row(parameter: click.Parameter, context: click.Context) -> str | None:
    """A table's row: names with what they take; the text of the help with default and range."""
    if isinstance(parameter, click.Argument):
        return (
            f"| `{parameter.make_metavar(context)}` | {_cell(str(getattr(parameter, 'help', None) or ''))} |"
        )
    record = parameter.get_help_record(context)
    if record is None:
        return None
    names, text = record
    return f"| `{names.replace('|', chr(92) + '|')}` | {_cell(text)} |"
