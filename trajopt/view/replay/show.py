"""Replay of solutions: a live Meshcat server, or one HTML page that needs no server and no network."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trajopt.arguments import checked
from trajopt.solution.input import SolutionOrFile, require_motion, solutions_of
from trajopt.solution.output import check_output, replacing
from trajopt.view.replay.live import LiveWindow, server_address_text
from trajopt.view.replay.motion import replay_motions
from trajopt.view.replay.page import page
from trajopt.view.replay.scene import build_scene

# Seconds between two looks whether the server is to end.
LOOK = 0.1


@dataclass(frozen=True, kw_only=True)
class Replay:
    """The result of a replay.

    frames: pictures of the animation; duration: seconds it plays (solution time over speed).
    note: one line if a robot could not be drawn with its meshes, else empty.
    facts: the page's text: phases, layers, runs, lines of its caption; see `ReplayScene`.
    html, size: the page and its bytes, or url, window: where the Meshcat server shows it, and the window
    through which a script can add to it, as in ``meshcat.Visualizer(window=shown.window)``.
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

    Keep a live replay up with `serve`. The page is written atomically. Without meshes a robot is drawn as a
    skeleton, with a line on stderr.

    Args:
        solutions: One or several, or the paths of their files.
        html: The page; without one a Meshcat server is started.
        open_browser: Open the server's page, if there is a screen.
        speed: Initial playback speed; 1 is real time, 0.2 five times slower.
        layout: Of several solutions, "overlaid" or "side-by-side"; default: side by side if their
            robots differ.
        labels: Their names.

    Raises:
        InputError: For a speed that is not positive, a solution of no duration, an unknown layout, labels of
            another number, or a file that cannot be written.
        TrajoptError: If the server does not start.
    """
    target = None if html is None else check_output(Path(html))
    several = [require_motion(solution) for solution in solutions_of(solutions)]
    motions = replay_motions(several, speed)
    scene = build_scene(several, motions, layout, labels)
    if scene.note:
        print(scene.note, file=sys.stderr)
    shown: dict[str, Any] = {"frames": motions[0].n_frames, "note": scene.note, "facts": scene.facts}
    shown["duration"] = (motions[0].n_frames - 1) / motions[0].frame_rate
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


def serve(shown: Replay, leaving: Callable[[], bool] = bool) -> None:
    """Block until Ctrl-C, the end of the server or ``leaving()``, then stop the server of a live replay."""
    if shown.window is None:
        return
    try:
        while not (leaving() or shown.window.ended(LOOK)):
            pass
    except KeyboardInterrupt:
        pass
    finally:
        shown.close()
