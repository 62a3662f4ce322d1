"""Replay of a solution: a live Meshcat server, or one HTML page that needs no server and no network."""

from __future__ import annotations

import contextlib
import io
import math
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import meshcat

from trajopt.errors import InputError, TrajoptError
from trajopt.replay.caption import page_facts
from trajopt.replay.motion import motion_of
from trajopt.replay.page import page
from trajopt.replay.scene import Scene, build_scene
from trajopt.solution import Solution


@dataclass(frozen=True, kw_only=True)
class Replay:
    """What was shown and where.

    frames: pictures of the animation; duration: seconds it plays (solution time over speed).
    note: one line if the robot could not be drawn with its meshes, else empty.
    html, size: the page and its bytes, or url: where the Meshcat server shows it.
    """

    frames: int
    duration: float
    note: str = ""
    html: Path | None = None
    size: int = 0
    url: str = ""
    window: Any = field(default=None, repr=False)

    def close(self) -> None:
        """Stop the Meshcat server, if there is one."""
        if self.window is not None and self.window.server_proc.poll() is None:
            self.window.server_proc.kill()
            self.window.server_proc.wait()


def replay(
    solution: Solution, html: str | Path | None = None, open_browser: bool = True, speed: float = 1.0
) -> Replay:
    """Show ``solution`` in Meshcat, or write it to the self-contained page ``html``; does not block.

    open_browser: without ``html``, open the server's page. speed: 1 is real time, 0.2 five times slower.
    Without meshes the robot is drawn as a skeleton, which one line on stderr says. Keep a live
    replay up with `serve`. Raises `InputError` for a speed that is not positive, a solution of
    no duration, or a file that cannot be written.
    """
    if not (math.isfinite(speed) and speed > 0):
        raise InputError(f"speed is {speed:g}", "a positive number; 1 is real time")
    motion = motion_of(solution, speed)
    scene = build_scene([solution], [motion])
    if scene.note:
        print(scene.note, file=sys.stderr)
    duration = (motion.n_frames - 1) / motion.frame_rate
    if html is not None:
        target = Path(html).expanduser()
        size = _write(target, page(scene, page_facts(scene, [solution], [motion])))
        return Replay(frames=motion.n_frames, duration=duration, note=scene.note, html=target, size=size)
    window = _live(scene)
    print(f"replay at {window.web_url}")
    if open_browser:
        window.open()
    return Replay(
        frames=motion.n_frames, duration=duration, note=scene.note, url=window.web_url, window=window
    )


def serve(shown: Replay) -> None:
    """Block until Ctrl-C (or the end of the server), then stop the server of a live replay."""
    if shown.window is None:
        return
    try:
        shown.window.server_proc.wait()
    except KeyboardInterrupt:
        pass
    finally:
        shown.close()


def _write(target: Path, text: str) -> int:
    data = text.encode()
    try:
        target.write_bytes(data)
    except OSError as error:
        raise InputError(
            f"cannot write {target}: {error.strerror or error}", "a file in an existing folder"
        ) from None
    return len(data)


def _live(scene: Scene) -> Any:
    """Start a Meshcat server that shows ``scene`` and return its window."""
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # Meshcat announces its URL itself
            window = meshcat.Visualizer().window
    except (OSError, RuntimeError, ValueError) as error:
        raise TrajoptError(f"the Meshcat server does not start: {error}") from None
    for command in scene.commands:
        window.send(command)
    return window
