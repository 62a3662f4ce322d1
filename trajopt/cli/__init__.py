"""The command line: options in, one call, a report out."""

from __future__ import annotations

import sys

INTERRUPTED = 130


def main() -> int:
    """Run the command line; Ctrl-C while it is imported ends without a traceback."""
    try:
        from trajopt.cli.commands import main as run
    except KeyboardInterrupt:
        print("trajopt: cancelled", file=sys.stderr)
        return INTERRUPTED
    return run()
