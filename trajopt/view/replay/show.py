"""Replay of solutions: a live Meshcat server, or one HTML page that needs no server and no network."""

from __future__ import annotations

import atexit
import os
import socket
import subprocess
import sys
import tempfile
import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from meshcat.visualizer import ViewerWindow

from trajopt.arguments import checked
from trajopt.errors import TrajoptError, without_nonfinite
from trajopt.motion.input import SolutionOrFile, require_motion, solutions_of
from trajopt.motion.output import check_output, replacing
from trajopt.view.replay import server
from trajopt.view.replay.commands import ViewerCommand
from trajopt.view.replay.motion import replay_motions
from trajopt.view.replay.page import live_page, page
from trajopt.view.replay.scene import build_scene

# Interval between checks whether to stop the server, s.
LOOK = 0.1
# Without one of these variables a browser would open in the terminal, if at all.
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


@dataclass(frozen=True, kw_only=True)
class Replay:
    """The result of a replay.

    Args:
        frames: number of pictures of the animation.
        duration: playback time, s: solution time over speed.
        note: one line if a robot could not be drawn with its meshes, else empty.
        html, size: the written page, and its size in bytes.
        url: address of the Meshcat server of a live replay.
        facts: the page's text: phases, layers, runs, lines of its caption; see `ReplayScene`.
        window: lets a script add to a live replay: ``meshcat.Visualizer(window=shown.window)``.
    """

    frames: int
    duration: float
    note: str = ""
    html: Path | None = None
    size: int = 0
    url: str = ""
    facts: dict[str, Any] = field(default_factory=dict, repr=False)
    window: LiveWindow | None = field(default=None, repr=False)

    def close(self) -> None:
        """Stop the Meshcat server, if there is one."""
        if self.window is not None:
            self.window.close()


@checked
def replay(
    solutions: SolutionOrFile | Sequence[SolutionOrFile],
    html: str | Path | None = None,
    open_browser: bool = True,
    speed: float = 1.0,
    layout: str | None = None,
    labels: Sequence[str] | None = None,
) -> Replay:
    """Show solutions in Meshcat, or write them to the self-contained page ``html``; does not block.

    Keep a live replay up with `serve`. Without meshes a robot is drawn as a skeleton, with a line on stderr.

    Args:
        solutions: One or several, or the paths of their files.
        html: The page; without one a Meshcat server is started.
        open_browser: Open the server's page, if there is a screen.
        speed: Initial playback speed; 1 is real time, 0.2 five times slower.
        layout: Of several solutions, "overlaid" or "side-by-side"; default: side by side if their
            robots differ.
        labels: Their names.

    Raises:
        InputError: For a speed that is not positive, a solution of no duration, an unknown layout, another
            number of labels, or a file that cannot be written.
        TrajoptError: If the server does not start.
    """
    target = None if html is None else check_output(Path(html))
    several = [require_motion(solution) for solution in solutions_of(solutions)]
    motions = replay_motions(several, speed)
    scene = build_scene(several, motions, layout, labels)
    if scene.note:
        print(scene.note, file=sys.stderr)
    shown: dict[str, Any] = {"frames": motions[0].n_frames, "duration": motions[0].duration}
    shown |= {"note": scene.note, "facts": scene.facts}
    if target is not None:
        with replacing(target) as unfinished:
            size = unfinished.write_bytes(page(scene).encode())
        return Replay(**shown, html=target, size=size)
    window = LiveWindow()
    window.show(scene.commands, scene.facts)
    print(server_address_text(window.web_url))
    if open_browser:
        window.open()
    return Replay(**shown, url=window.web_url, window=window)


def serve(shown: Replay, leaving: Callable[[], bool] | None = None) -> None:
    """Block until Ctrl-C, the end of the server or ``leaving()``, then stop the server of a live replay."""
    if shown.window is None:
        return
    try:
        while not ((leaving is not None and leaving()) or shown.window.ended(LOOK)):
            pass
    except KeyboardInterrupt:
        pass
    finally:
        shown.close()


class LiveWindow(ViewerWindow):
    """A Meshcat window with a separate server, whose page has the player's caption, phases and cameras.

    It accepts everything that Meshcat's window accepts. Raises `TrajoptError` if the server does not start.
    """

    def __init__(self) -> None:
        self.server_proc, self.zmq_url, self.web_url = _started()
        atexit.register(self.close)
        self.connect_zmq()

    def show(self, commands: Sequence[ViewerCommand], facts: dict[str, Any]) -> None:
        """Send a scene and its facts, of a `ReplayScene`, to the server; open browsers show it at once."""
        self.zmq_socket.send_multipart([server.PAGE.encode(), b"", live_page(facts).encode()])
        self.zmq_socket.recv()
        self.tell("facts", facts)
        for command in commands:
            self.send(command)
        self.tell("drawn", True)

    def send(self, command: Any) -> None:
        """Send a command. Raises `TrajoptError` if the server has ended: another may have its port by now."""
        if self.server_proc.poll() is not None:
            raise TrajoptError("the Meshcat server has ended")
        super().send(command)

    def tell(self, path: str, value: Any) -> None:
        """Send to the page, not to Meshcat's viewer: "facts", or "drawn" when the scene is complete."""
        self.send(ViewerCommand({"type": server.OWN, "path": path, "value": without_nonfinite(value)}))

    def open(self) -> LiveWindow:
        """Open the page in the browser, if there is a screen."""
        open_address(self.web_url)
        return self

    def ended(self, timeout: float) -> bool:
        """Wait for the end of the server, at most ``timeout`` s; returns whether it has ended."""
        try:
            self.server_proc.wait(timeout)
        except subprocess.TimeoutExpired:
            return False
        return True

    def close(self) -> None:
        """Stop the server; does nothing if it has stopped."""
        atexit.unregister(self.close)
        if self.server_proc.stdin is not None:
            self.server_proc.stdin.close()
        if self.server_proc.poll() is None:
            self.server_proc.kill()
        self.server_proc.wait()
        if self.server_proc.stdout is not None:
            self.server_proc.stdout.close()
        self.zmq_socket.close(linger=0)


def open_address(url: str) -> None:
    """Open a page in the browser, if there is a screen."""
    if sys.platform in ("win32", "darwin") or any(os.environ.get(name) for name in DISPLAYS):
        webbrowser.open(url, new=2)


def server_address_text(url: str, what: str = "replay") -> str:
    """Return the message about a server of ``what``: its address and, over ssh, how to reach it."""
    if not os.environ.get("SSH_CONNECTION"):
        return f"{what} at {url}"
    port = url.rstrip("/").rpartition(":")[2]
    return f"{what} at {url} (from your own machine: ssh -L {port}:127.0.0.1:{port} {socket.gethostname()})"


def _started() -> tuple[subprocess.Popen[str], str, str]:
    """The server's process, and its addresses for Python and for browsers; it uses free ports."""
    # -P: the file's folder has modules whose names others may import.
    command, pipe = [sys.executable, "-u", "-P", server.__file__], subprocess.PIPE
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as complaints:
        # A separate session: Ctrl-C is handled in this process, which stops the server.
        process = subprocess.Popen(
            command, stdin=pipe, stdout=pipe, stderr=complaints, text=True, start_new_session=True
        )
        assert process.stdout is not None
        try:
            lines = [process.stdout.readline().strip() for _ in range(2)]
        except BaseException:  # Ctrl-C
            process.kill()
            raise
        if not (lines[0].startswith("zmq_url=") and lines[1].startswith("web_url=")):
            process.kill()
            process.wait()
            complaints.seek(0)
            reason = (complaints.read().strip().splitlines() or ["it ended at once"])[-1]
            raise TrajoptError(f"the Meshcat server does not start: {reason}")
    return process, lines[0].removeprefix("zmq_url="), lines[1].removeprefix("web_url=")
