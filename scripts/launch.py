"""The command ``trajopt``: import the command line, and say in one line what keeps it from starting."""

from __future__ import annotations

import sys

BAD_INSTALLATION = 2
INTERRUPTED = 130


def main() -> int:
    """Run the command line; a mismatch of wheels or Ctrl-C while importing ends without a traceback."""
    try:
        from trajopt.cli import main as run
    except KeyboardInterrupt:
        print("trajopt: cancelled", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        # Its class cannot be imported when the package itself refuses to start.
        if type(error).__name__ != "VersionMismatchError":
            raise
        print(f"trajopt: {error}", file=sys.stderr)
        return BAD_INSTALLATION
    return run()


if __name__ == "__main__":
    sys.exit(main())
