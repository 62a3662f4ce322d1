"""A live replay: a Meshcat server with our own page, to which scripts can send further commands."""

from __future__ import annotations

import atexit
import os
import socket
import subprocess
import sys
import tempfile
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

from meshcat.visualizer import ViewerWindow

from trajopt.errors import TrajoptError
from trajopt.view.replay import server
from trajopt.view.replay.commands import ViewerCommand
from trajopt.view.replay.page import live_page, without_nonfinite

# Without one of these variables a browser would open in the terminal, if at all.
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


class LiveWindow(ViewerWindow):
    """A Meshcat window with a separate server, whose page has the player's caption, phases and cameras.

    It accepts everything that Meshcat's window accepts. Raises `TrajoptError` if the server does not start.
    """

    def __init__(self) -> None:
        self.server_proc, self.zmq_url, self.web_url = _started()
        atexit.register(self.close)
        self.connect_zmq()

    def show(self, commands: Sequence[ViewerCommand], facts: dict[str, Any]) -> None:
        """Send a scene and its facts to the server; open browsers show it at once.

        facts: of a `ReplayScene`.
        """
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
        if can_open():
            webbrowser.open(self.web_url, new=2)
        return self

    def ended(self, timeout: float) -> bool:
        """Wait for the end of the server, at most ``timeout`` s; returns whether it has ended."""
        try:
            self.server_proc.wait(timeout)
        except subprocess.TimeoutExpired:
            return False
        return True

    def close(self) -> None:
        """Stop the server; nothing if it has stopped."""
        atexit.unregister(self.close)
        if self.server_proc.stdin is not None:
            self.server_proc.stdin.close()
        if self.server_proc.poll() is None:
            self.server_proc.kill()
        self.server_proc.wait()
        if self.server_proc.stdout is not None:
            self.server_proc.stdout.close()
        self.zmq_socket.close(linger=0)


def can_open() -> bool:
    """Whether a browser would have a screen here."""
    return sys.platform in ("win32", "darwin") or any(os.environ.get(name) for name in DISPLAYS)


def server_address_text(url: str) -> str:
    """Return the message about a server: its address and, over ssh, how to reach it."""
    if not os.environ.get("SSH_CONNECTION"):
        return f"replay at {url}"
    port = url.rstrip("/").rpartition(":")[2]
    return f"replay at {url} (from your own machine: ssh -L {port}:127.0.0.1:{port} {socket.gethostname()})"


def _started() -> tuple[subprocess.Popen[str], str, str]:
    """The server's process, and its addresses for Python and for browsers; it uses free ports."""
    # -P: the file's folder has modules whose names others may import.
    command = [sys.executable, "-u", "-P", str(Path(server.__file__))]
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as complaints:
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=complaints,
            text=True,
            start_new_session=True,  # Ctrl-C is handled in this process, which stops the server
        )
        try:
            lines = [_line(process.stdout, name) for name in ("zmq_url", "web_url")]
        except BaseException:  # Ctrl-C
            process.kill()
            raise
        if not all(lines):
            process.kill()
            process.wait()
            complaints.seek(0)
            said = complaints.read().strip().splitlines()
            raise TrajoptError(
                f"the Meshcat server does not start: {said[-1] if said else 'it ended at once'}"
            )
    return process, lines[0], lines[1]


def _line(stream: IO[str] | None, name: str) -> str:
    """The value of the next line NAME=VALUE; empty at the end of the stream."""
    text = stream.readline().strip() if stream is not None else ""
    return text.removeprefix(f"{name}=") if text.startswith(f"{name}=") else ""
