"""Commands with Ctrl-C pressed at chosen moments, asked by one line of JSON on stdin: run as a module.

Each moment is pressed in a fork of this process, which has loaded the library, with a terminal of its own. A
moment is named by a function of the main thread, not by a time: ``[module, qualified name, event, count]``,
where module is its last name, event "call" or "return", and count says which of them. Without a name every
call of Python counts, and one that does not come is pressed when the command waits for Ctrl-C. Answers are
lines of JSON.
"""

import atexit
import importlib
import json
import os
import pty
import select
import signal
import sys
import time
from types import FrameType
from typing import Any

from trajopt import cli

# What a command says that waits for Ctrl-C.
WAITS = "Ctrl-C stops the server"
LOOK = 0.05


def main() -> None:
    """Answer for each moment: exit status, what was shown, calls until the press; nothing after one hangs."""
    asked = json.loads(sys.stdin.readline())
    for module in ("scipy.integrate", "trajopt.cli.solve", "trajopt.view.watching.viewer"):
        importlib.import_module(module)
    for moment in asked["moments"]:
        read, write = os.pipe()
        child, terminal = pty.fork()
        if child == 0:
            os.close(read)
            sys.argv = ["trajopt", *asked["arguments"]]
            _press_at(moment, write)
            sys.exit(cli.main())
        os.close(write)
        status, seen = _watched(child, terminal, asked["limit"], -1 if moment[1] else read)
        calls = os.read(read, 100).decode()
        os.close(read)
        print(json.dumps({"status": status, "seen": seen, "calls": int(calls or 0)}), flush=True)
        if status is None:
            return


def _press_at(moment: list[Any], told: int) -> None:
    """Press Ctrl-C, as a terminal does, when the moment comes; tell how many calls that took, or all took."""
    module, name, event, count = moment
    calls = here = 0

    def tell() -> None:
        os.write(told, str(calls).encode())

    def look(frame: FrameType, what: str, _: Any) -> None:
        nonlocal calls, here
        calls += what == "call"
        if what == event and (
            not name
            or (
                frame.f_code.co_qualname == name
                and frame.f_globals.get("__name__", "").endswith(f".{module}")
            )
        ):
            here += 1
            if here == count:
                sys.setprofile(None)
                atexit.unregister(tell)
                tell()
                os.killpg(0, signal.SIGINT)

    atexit.register(tell)
    sys.setprofile(look)


def _watched(child: int, terminal: int, limit: float, told: int) -> tuple[int | None, str]:
    """Read the terminal of a command to its end.

    It is told to end if it shows what Ctrl-C has stopped, or waits although nothing is ``told`` of a press.
    """
    seen, end, pressed = "", time.monotonic() + limit, False
    while time.monotonic() < end:
        if not select.select([terminal], [], [], LOOK)[0]:
            continue
        try:
            data = os.read(terminal, 65536)
        except OSError:  # Linux: the other end is closed
            break
        seen += data.decode(errors="replace")
        untold = told >= 0 and not select.select([told], [], [], 0.0)[0]
        if WAITS in seen and not pressed and (untold or "interrupted" in seen):
            pressed = True
            os.write(terminal, b"\x03")
    else:
        os.killpg(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return None, seen
    os.close(terminal)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), seen


if __name__ == "__main__":
    main()
