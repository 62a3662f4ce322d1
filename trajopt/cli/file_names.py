"""Names of solution files that tell the settings they were solved with."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from trajopt.errors import InputError

# Arguments of commands that do not change the motion.
SAME_MOTION = {
    "problem", "output", "output_dir", "vary", "as_json", "watch", "log", "diagnosed", "explain",
    "threads", "compare", "nearest",
}  # fmt: skip
# Arguments whose values are NAME=VALUE already.
NAMED = {"settings", "solver_options"}
# Characters that are replaced in a name, and the most characters that it may have.
UNSAFE, LONGEST = re.compile(r"[^\w.=+,@-]+"), 200


def name_of_settings(context: click.Context, *last: str) -> str:
    """Name of a problem with the settings of a command that change the motion, joined by hyphens.

    Args:
        context: of a command that has an argument ``problem``.
        last: further words of the name.

    Raises:
        InputError: for a name that is too long for a file.
    """
    words = [context.params["problem"]]
    for option in context.command.params:
        value = context.params.get(str(option.name))  # none of one without a value
        if option.name not in SAME_MOTION and value and value != option.get_default(context):
            words += _words(option, value)
    name = UNSAFE.sub("_", "-".join((*words, *last)).replace(" ", ""))
    if len(name) > LONGEST:
        raise InputError(f"the settings make a file name of {len(name)} characters", "allowed: --output FILE")
    return name


def file_of_settings(context: click.Context, *last: str) -> Path:
    """File that is written without ``--output``, such as ``solo12-jump-distance=0.8-smallest.npz``."""
    return Path(f"{name_of_settings(context, *last)}.npz")


def _words(option: click.Parameter, value: Any) -> list[str]:
    title = option.opts[0].removeprefix("--")
    if isinstance(value, tuple):
        return [each if option.name in NAMED else f"{title}={each}" for each in value]
    if value is True:
        return [title]
    return [f"{title}={value.with_suffix('') if isinstance(value, Path) and value.name else value}"]
