"""Commands whose help lists options in groups, and groups of commands that are imported by name."""

from __future__ import annotations

import collections
import importlib
from collections.abc import Mapping, Sequence
from typing import Any

import click
from typing_extensions import override

from trajopt.errors import not_among


class GroupedCommand(click.Command):
    """A command whose help shows its options under headings.

    groups: by heading, the names of the arguments, separated by spaces. Options without a group come last.
    """

    def __init__(self, *args: Any, groups: Mapping[str, str], **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.groups = groups

    @override
    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        records: dict[str, tuple[str, str]] = {}
        for parameter in self.get_params(ctx):
            if isinstance(parameter, click.Argument):
                continue  # in the usage line, and in the text
            record = parameter.get_help_record(ctx)
            if record is not None:
                records[str(parameter.name)] = record
        sections = {
            heading: [records.pop(name) for name in names.split() if name in records]
            for heading, names in self.groups.items()
        }
        for heading, shown in {**sections, "Other options": list(records.values())}.items():
            if shown:
                with formatter.section(heading):
                    formatter.write_dl(shown)


class LazyGroup(click.Group):
    """A group whose commands are imported when they are looked up.

    modules: by the command's name ``module:function``.
    """

    def __init__(self, *args: Any, modules: Mapping[str, str], **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.modules = modules

    @override
    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(self.modules)

    @override
    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self.modules:
            return None
        module, _, function = self.modules[cmd_name].partition(":")
        command: click.Command = getattr(importlib.import_module(module), function)
        return command

    @override
    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args[0] not in self.modules:
            error = not_among(self.list_commands(ctx), args[0], f"no command '{args[0]}'")
            raise click.UsageError(str(error), ctx)
        name, command, rest = super().resolve_command(ctx, args)
        if command is not None:
            _require_once(command, click.Context(command, parent=ctx, info_name=name), rest)
        return name, command, rest


def _require_once(command: click.Command, context: click.Context, args: Sequence[str]) -> None:
    """Raise for an option of one value that is given several: click would keep the last one silently."""
    if isinstance(command, click.Group):
        return  # whose command is not resolved yet
    _, _, order = command.make_parser(context).parse_args(list(args))
    for option, times in collections.Counter(order).items():
        if times > 1 and isinstance(option, click.Option) and not (option.multiple or option.is_flag):
            name = max(option.opts, key=len)
            raise click.UsageError(f"{name} is given {times} times; allowed: once", context)
