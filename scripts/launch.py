"""The command ``trajopt``: import the command line, and say in one line what keeps it from starting."""

from __future__ import annotations

import signal
import sys
from types import FrameType

BAD_INSTALLATION = 2
INTERRUPTED = 130


def main() -> int:
    """Run the command line; a mismatch of wheels or Ctrl-C while importing ends without a traceback."""
    presses: list[int] = []

    def press(number: int, frame: FrameType | None) -> None:
        presses.append(number)
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, press)
    try:
        from trajopt.cli import main as run

        if not presses:  # a library that is imported may lose the exception
            return run()
    except KeyboardInterrupt:
        pass
    except Exception as error:
        # Its class cannot be imported when the package itself refuses to start.
        if not presses:
            if type(error).__name__ != "VersionMismatchError":
                raise
            print(f"trajopt: {error}", file=sys.stderr)
            return BAD_INSTALLATION
    print("trajopt: cancelled", file=sys.stderr)
    return INTERRUPTED


if __name__ == "__main__":
    sys.exit(main())
