"""The command line: a thin layer over the library.

Exit status: 0 done; 1 ran but not solved (``solve``) or not within tolerance (``check``); 2 bad
input, with one line on stderr; 130 cancelled by Ctrl-C. The exit status of ``solve`` depends on the solver's
status alone: if the problem is solved but the motion is beyond the tolerances of a check, the summary (and
``accuracy`` of the JSON) says so and the exit status is 0: a finer mesh is needed, not another solve.

A command's module is imported when the command is looked up, and imports slow libraries inside its function:
``--help`` loads neither CasADi, Pinocchio nor NumPy.
"""

import collections
import importlib
import re
import sys
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import click
from typing_extensions import override

from trajopt import __version__
from trajopt.cli.interruption import CANCELLED, INTERRUPTION
from trajopt.cli.report import say
from trajopt.errors import TrajoptError, not_among

BAD_INPUT = 2
# Commands by name, each as ``module:function``.
COMMANDS = {
    "batch": "trajopt.cli.batch:batch_command",
    "check": "trajopt.cli.check:check_command",
    "continue": "trajopt.cli.continuation:continue_command",
    "diagnose": "trajopt.cli.check:diagnose_command",
    "discover": "trajopt.cli.discover:discover_command",
    "drive": "trajopt.cli.drive:drive_command",
    "export": "trajopt.cli.export:export_command",
    "list": "trajopt.cli.list:list_command",
    "plot": "trajopt.cli.view:plot_command",
    "push": "trajopt.cli.simulate:push_command",
    "render": "trajopt.cli.view:render_command",
    "replay": "trajopt.cli.view:replay_command",
    "robot": "trajopt.cli.robot:robot_command",
    "simulate": "trajopt.cli.simulate:simulate_command",
    "solve": "trajopt.cli.solve:solve_command",
    "walk": "trajopt.cli.simulate:walk_command",
    "bench": "trajopt.cli.bench:bench",
}


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


class CommandLine(LazyGroup):
    """The commands; bad input is reported in one line, with exit status 2."""

    @override
    def main(  # type: ignore[override]
        self, args: Sequence[str] | None = None, prog_name: str | None = None, **extra: Any
    ) -> None:
        extra["standalone_mode"] = False
        with warnings.catch_warnings(), INTERRUPTION.handling():
            warnings.simplefilter("ignore")  # deprecations inside libraries
            warnings.simplefilter("always", UserWarning)
            warnings.showwarning = _show_warning
            try:
                status = self._status(args, prog_name or "trajopt", extra)
            except (KeyboardInterrupt, click.Abort):
                status = _cancelled()
            except Exception:
                if not INTERRUPTION.pressed:  # else the error was caused by Ctrl-C
                    raise
                status = _cancelled()
        sys.exit(status)

    def _status(self, args: Sequence[str] | None, prog_name: str, extra: dict[str, Any]) -> int:
        try:
            status = super().main(args, prog_name, **extra)
            return status if isinstance(status, int) else 0
        except click.UsageError as error:
            return _refuse(_usage(error))
        except click.ClickException as error:
            return _refuse(error.format_message())
        except TrajoptError as error:
            return _refuse(str(error))
        except OSError as error:
            return _refuse(f"{error.filename or 'input or output'}: {error.strerror or error}")

    @override
    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            return _cancelled()


def _require_once(command: click.Command, context: click.Context, args: Sequence[str]) -> None:
    """Raise for an option of one value that is given several: click would keep the last one silently."""
    if isinstance(command, click.Group):
        return  # whose command is not resolved yet
    _, _, order = command.make_parser(context).parse_args(list(args))
    for option, times in collections.Counter(order).items():
        if times > 1 and isinstance(option, click.Option) and not (option.multiple or option.is_flag):
            name = max(option.opts, key=len)
            raise click.UsageError(f"{name} is given {times} times; allowed: once", context)


def _cancelled() -> int:
    INTERRUPTION.deferred = True
    INTERRUPTION.answer()
    say("trajopt: cancelled", err=True)
    return CANCELLED


def _refuse(message: str) -> int:
    say(f"trajopt: {' '.join(message.split())}", err=True)
    return BAD_INPUT


def _usage(error: click.UsageError) -> str:
    where = error.ctx.command_path if error.ctx else "trajopt"
    extra = re.search(r"unexpected extra arguments? \((\S+=[^\s)]+)", error.format_message())
    if extra and error.ctx and any("--set" in each.opts for each in error.ctx.command.params):
        return f"'{extra[1]}' stands alone; allowed: --set {extra[1]}; see '{where} --help'"
    return f"{error.format_message().rstrip('.')}; see '{where} --help'"


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    say(f"trajopt: warning: {' '.join(str(message).split())}", err=True)


@click.group(
    cls=CommandLine,
    modules=COMMANDS,
    no_args_is_help=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__)
def main() -> None:
    """Trajectory optimisation for robots with contacts."""
