"""The command line: options in, one call, a report out."""

from __future__ import annotations

import signal
import sys
from types import FrameType

INTERRUPTED = 130


def main() -> int:
    """Run the command line; Ctrl-C while importing ends without a traceback."""
    presses: list[int] = []

    def press(number: int, frame: FrameType | None) -> None:
        presses.append(number)
        raise KeyboardInterrupt

    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, press)
    try:
        from trajopt.cli.commands import main as run

        if not presses:  # importing a library may lose the exception
            return run()
    except KeyboardInterrupt:
        pass
    except Exception:
        if not presses:
            raise
    finally:
        # Under `-m`, CPython ends by SIGINT, not with a status, after Ctrl-C in text given to `exec` (by
        # `dataclass`, for example), until another text is executed.
        exec("")
    print("trajopt: cancelled", file=sys.stderr)
    return INTERRUPTED
