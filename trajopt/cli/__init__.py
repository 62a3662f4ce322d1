"""The command line: options in, one call, a report out."""

import gc
import sys

from trajopt.cli.interruption import CANCELLED, INTERRUPTION

# Objects between two searches for garbage: with Python's 700 they take a tenth of a start.
GARBAGE = 200_000


def main() -> int:
    """Run the command line; Ctrl-C while importing ends without a traceback."""
    gc.set_threshold(GARBAGE)
    with INTERRUPTION.handling():
        try:
            from trajopt.cli.commands import main as run

            INTERRUPTION.check()  # importing a library may have lost the exception
            return run()
        except KeyboardInterrupt:
            pass
        except Exception:
            if not INTERRUPTION.pressed:
                raise
        finally:
            # Under `-m`, CPython ends by SIGINT, not with a status, after Ctrl-C in text given to `exec` (by
            # `dataclass`, for example), until another text is executed.
            exec("")
        print("trajopt: cancelled", file=sys.stderr)
        return CANCELLED
