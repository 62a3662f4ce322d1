"""One HTML page that holds a replay whole: the viewer's code, the meshes and the animation."""

from __future__ import annotations

import base64
import gzip
import hashlib
import html
import json
from pathlib import Path
from typing import Any

import meshcat
import umsgpack

from trajopt.errors import TrajoptError
from trajopt.replay.motion import FLASH, Motion
from trajopt.replay.scene import Scene
from trajopt.solution import Solution

VIEWER = Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js"
# The browser itself refuses every load from elsewhere.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval' blob:; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src data: blob:; worker-src blob:"
)

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<title>{title}</title>
<style>
body {{ margin: 0; font: 13px/1.5 system-ui, sans-serif; color: #222a33; }}
#meshcat-pane {{ width: 100vw; height: 100vh; overflow: hidden; }}
#caption {{ position: absolute; left: 14px; top: 10px; pointer-events: none; }}
#caption b {{ font-size: 15px; }}
#clock {{ font-variant-numeric: tabular-nums; }}
.failed {{ color: #b3261e; }}
.arrow {{ color: #b5330f; }}
.impulse {{ color: #7a1fa2; }}
</style>
</head>
<body>
<div id="meshcat-pane"></div>
<div id="caption">{caption}<div id="clock"></div></div>
<script>
{viewer}
</script>
<script id="scene" type="application/octet-stream;base64">{scene}</script>
<script>
{player}
</script>
</body>
</html>
"""

PLAYER = """
"use strict";
const replay = %s;
const viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
const animator = viewer.animator;

function showScene(scene) {
    const restore = part => { if (part && part.shared !== undefined) part.data = scene.meshes[part.shared]; };
    for (const command of scene.commands) {
        if (command.object) {
            (command.object.geometries || []).forEach(restore);
            restore(command.object.object);
        }
        try {
            viewer.handle_command(command);
        } catch (error) {  // one part that the viewer cannot read leaves the others
            console.error(command.path, error);
        }
    }
}

// The picture holds for a moment at the end, then starts again; the clock shows the solution's time.
function followClock() {
    const pause = animator.pause, progress = animator.display_progress;
    animator.pause = function () {
        const ended = this.actions.length > 0 && this.actions.every(action => action.paused);
        pause.call(this);
        if (ended) setTimeout(() => { if (!this.playing && this.time >= this.duration) this.play(); }, 800);
    };
    const clock = document.getElementById("clock");
    animator.display_progress = function (time) {
        progress.call(this, time);
        clock.textContent = "t = " + (replay.start + time * replay.speed).toFixed(2) + " s";
    };
    document.addEventListener("keydown", event => {
        if (event.code !== "Space") return;
        event.preventDefault();
        animator.playing ? animator.pause() : animator.play();
    });
}

function showAt(time) {
    animator.play();
    animator.pause();
    animator.seek(time);
    animator.display_progress(Math.max(0, Math.min(animator.duration, time)));
}

// "page.html#t=0.35" opens paused at that time of the solution; otherwise the page plays once it is drawn.
function begin() {
    const wanted = /^#t=([0-9.eE+-]+)$/.exec(location.hash);
    showAt(wanted ? (Number(wanted[1]) - replay.start) / replay.speed : 0);
    if (!wanted) requestAnimationFrame(() => requestAnimationFrame(() => animator.play()));
}

function arrangePanel() {
    viewer.gui.open();
    for (const name of ["Scene", "Save / Load / Capture"]) viewer.gui.__folders[name].close();
}

async function start() {
    const text = document.getElementById("scene").textContent;
    const packed = Uint8Array.from(atob(text), letter => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    followClock();
    viewer.handle_command = scene => { delete viewer.handle_command; showScene(scene); };
    viewer.handle_command_bytearray(bytes);  // decodes, then hands over to the line above
    arrangePanel();
    begin();
    window.addEventListener("hashchange", begin);
}
start();
"""


def page(scene: Scene, solution: Solution, motion: Motion) -> str:
    """Return the text of the page; raises `TrajoptError` if Meshcat's viewer is not installed whole."""
    try:
        viewer = VIEWER.read_text(encoding="utf-8")
        licence = VIEWER.with_name(VIEWER.name + ".LICENSE.txt").read_text(encoding="utf-8")
    except OSError as error:
        raise TrajoptError(f"Meshcat's viewer cannot be read: {error}") from None
    settings = {"start": float(motion.t[0]), "speed": motion.speed}
    return PAGE.format(
        policy=POLICY,
        title=html.escape(_title(solution)),
        caption=_caption(scene, solution, motion),
        viewer=f"{licence}\n{viewer}",
        scene=base64.b64encode(packed_scene(scene)).decode("ascii"),
        player=PLAYER % json.dumps(settings),
    )


def packed_scene(scene: Scene) -> bytes:
    """Return the scene as compressed msgpack: ``{"meshes": [...], "commands": [...]}``, each mesh once."""
    meshes: dict[bytes, Any] = {}
    commands = []
    for command in scene.commands:
        message = command.lower()
        if message["type"] == "set_animation":
            message = {**message, "options": {**message["options"], "repetitions": 1}}
        commands.append(_with_shared_meshes(message, meshes))
    data = umsgpack.packb(
        {"meshes": list(meshes.values()), "commands": commands}, force_float_precision="single"
    )
    return gzip.compress(data, compresslevel=9, mtime=0)


def _with_shared_meshes(message: dict[str, Any], meshes: dict[bytes, Any]) -> dict[str, Any]:
    """Return the message with the content of its geometries replaced by their place in ``meshes``."""

    def shared(part: dict[str, Any]) -> dict[str, Any]:
        if "data" not in part:
            return part
        key = hashlib.sha256(umsgpack.packb(part["data"])).digest()
        meshes.setdefault(key, part["data"])
        rest = {name: value for name, value in part.items() if name != "data"}
        return {**rest, "shared": list(meshes).index(key)}

    if message["type"] != "set_object":
        return message
    content = dict(message["object"])
    content["geometries"] = [shared(part) for part in content.get("geometries", [])]
    content["object"] = shared(content["object"])
    return {**message, "object": content}


def _title(solution: Solution) -> str:
    names = [solution.meta.get("problem"), solution.meta.get("robot")]
    return " – ".join(dict.fromkeys(str(name) for name in names if name)) or "trajectory"


def _caption(scene: Scene, solution: Solution, motion: Motion) -> str:
    lines = [f"<b>{html.escape(_title(solution))}</b>"]
    if not solution.meta.get("success", True):
        lines.append(
            f'<span class="failed">not solved: {html.escape(str(solution.meta.get("status")))}</span>'
        )
    length = f"{motion.t[-1] - motion.t[0]:.2f} s"
    lines.append(length if motion.speed == 1 else f"{length}, played at {motion.speed:g} times real time")
    if len(solution.contact_frames):
        scale = f"forces: {scene.weight_arrow:.2f} m is the weight, {motion.weight:.1f} N"
        lines.append(f'<span class="arrow">{scale}</span>')
    if motion.impact.any():
        scale = f"impulses: {scene.weight_arrow:.2f} m is {motion.weight * FLASH:.2f} N s"
        lines.append(f'<span class="impulse">{scale}</span>')
    if scene.note:
        lines.append(html.escape(scene.note))
    return "<br>".join(lines)
