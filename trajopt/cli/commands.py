"""The command line: a thin layer over the library.

Exit status: 0 done; 1 ran but not solved (``solve``) or not within tolerance (``check``); 2 bad
input, with one line on stderr; 130 cancelled by Ctrl-C. The exit status of ``solve`` depends on the solver's
status alone: if the problem is solved but the motion is beyond the tolerances of a check, the summary (and
``accuracy`` of the JSON) says so and the exit status is 0: a finer mesh is needed, not another solve.

A command's module is imported when the command is looked up, and imports slow libraries inside its function:
``--help`` loads neither CasADi, Pinocchio nor NumPy.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import Any

import click
from typing_extensions import override

from trajopt import __version__
from trajopt.cli.groups import LazyGroup
from trajopt.cli.interruption import CANCELLED, INTERRUPTION
from trajopt.cli.report import say
from trajopt.errors import TrajoptError

BAD_INPUT = 2
# Commands by name, each as ``module:function``.
COMMANDS = {
    "batch": "trajopt.cli.batch:batch_command",
    "check": "trajopt.cli.check:check_command",
    "continue": "trajopt.cli.continuation:continue_command",
    "diagnose": "trajopt.cli.check:diagnose_command",
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
