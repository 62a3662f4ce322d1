"""Commands whose help lists options in groups, and groups of commands that are imported by name."""

from __future__ import annotations

import importlib
from collections.abc import Collection, Mapping
from typing import Any

import click
from typing_extensions import override


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

    modules: by the command's name ``module:function``. earlier: names that are accepted, and not listed.
    """

    def __init__(
        self, *args: Any, modules: Mapping[str, str], earlier: Collection[str] = (), **settings: Any
    ) -> None:
        super().__init__(*args, **settings)
        self.modules, self.earlier = modules, earlier

    @override
    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted(set(self.modules) - set(self.earlier))

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
            known = ", ".join(self.list_commands(ctx))
            raise click.UsageError(f"no command '{args[0]}', allowed: {known}", ctx)
        return super().resolve_command(ctx, args)
