"""The command line: options in, one call, a report out."""

from __future__ import annotations

import sys

BAD_INSTALLATION = 2
INTERRUPTED = 130


def main() -> int:
    """Run the command line; a mismatch of wheels or Ctrl-C while importing ends without a traceback."""
    from trajopt.errors import VersionMismatchError

    try:
        from trajopt.cli.commands import main as run
    except KeyboardInterrupt:
        print("trajopt: cancelled", file=sys.stderr)
        return INTERRUPTED
    except VersionMismatchError as error:
        print(f"trajopt: {error}", file=sys.stderr)
        return BAD_INSTALLATION
    return run()
