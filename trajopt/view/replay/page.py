"""One HTML page with a complete replay: the viewer's code, the meshes and the animation."""

from __future__ import annotations

import base64
import gzip
import hashlib
import html
import json
import math
from functools import cache
from pathlib import Path
from string import Template
from typing import Any

import meshcat
import umsgpack

from trajopt.errors import TrajoptError
from trajopt.view.replay.meshes import compact_geometry
from trajopt.view.replay.scene import ReplayScene

VIEWER = Path(meshcat.__file__).parent / "viewer" / "dist" / "main.min.js"
WEB = Path(__file__).parent / "web"
# Compression level of the scene: higher levels take several times as long for 2 % less.
COMPRESSION = 6
# Scripts in order of dependency.
SCRIPTS = ("meshes.js", "scene.js", "clock.js", "cameras.js", "panel.js", "player.js")
# The browser itself refuses every load from elsewhere, and every script but the player and the viewer,
# which is a blob that the player makes. Meshcat's panel writes its own style.
POLICY = (
    "default-src 'none'; script-src 'sha256-{player}' blob:{code}; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src data: blob:{live}; worker-src blob:; base-uri 'none'; "
    "form-action 'none'"
)
# A live page talks to its server; scripts may send code for buttons.
LIVE = {"live": " 'self' ws://127.0.0.1:* ws://localhost:*", "code": " 'unsafe-eval'"}
ALONE = {"live": "", "code": ""}


def page(scene: ReplayScene) -> str:
    """Return the text of the page.

    Raises `TrajoptError` if Meshcat's viewer is not fully installed.
    """
    return _text({**scene.facts, "live": False}, ALONE, packed_scene(scene))


def live_page(facts: dict[str, Any]) -> str:
    """Return the text of a page that receives its scene from its server."""
    return _text({**facts, "live": True}, LIVE, b"")


def _text(facts: dict[str, Any], allowed: dict[str, str], scene: bytes) -> str:
    player = _player()
    digest = base64.b64encode(hashlib.sha256(player.encode()).digest()).decode("ascii")
    viewer, licence = _viewer()
    return Template((WEB / "page.html").read_text(encoding="utf-8")).substitute(
        policy=POLICY.format(player=digest, **allowed),
        title=html.escape(facts["title"]),
        style=(WEB / "page.css").read_text(encoding="utf-8"),
        licence=licence,
        viewer=viewer,
        scene=_text_of(scene),
        facts=_script_text(facts),
        player=player,
    )


@cache
def _player() -> str:
    """The player's code in a strict function, isolated from the rest of the page."""
    code = "\n".join((WEB / name).read_text(encoding="utf-8") for name in SCRIPTS)
    return f'\n(() => {{\n"use strict";\n{code}}})();\n'


@cache
def _viewer() -> tuple[str, str]:
    """Meshcat's viewer, compressed, and its licence."""
    try:
        code = VIEWER.read_bytes()
        licence = VIEWER.with_name(VIEWER.name + ".LICENSE.txt").read_text(encoding="utf-8")
    except OSError as error:
        raise TrajoptError(f"Meshcat's viewer cannot be read: {error}") from None
    return _text_of(gzip.compress(code, compresslevel=9, mtime=0)), licence.replace("</", "<\\/")


def _text_of(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def _script_text(value: object) -> str:
    """JSON that cannot end its script element; non-finite numbers are null."""
    return json.dumps(without_nonfinite(value), allow_nan=False).replace("<", "\\u003c")


def without_nonfinite(value: object) -> object:
    """Return a JSON-able value with None for non-finite numbers."""
    if isinstance(value, dict):
        return {str(key): without_nonfinite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [without_nonfinite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def packed_scene(scene: ReplayScene) -> bytes:
    """Return the scene as compressed msgpack: ``{"meshes": [...], "commands": [...]}``, each mesh once."""
    meshes: dict[bytes, Any] = {}
    names: dict[str, str] = {}
    commands = [_with_shared_meshes(_numbered(command.lower(), names), meshes) for command in scene.commands]
    data = umsgpack.packb(
        {"meshes": list(meshes.values()), "commands": commands}, force_float_precision="single"
    )
    return gzip.compress(data, compresslevel=COMPRESSION, mtime=0)


def _numbered(message: dict[str, Any], names: dict[str, str]) -> dict[str, Any]:
    """Return the message with numbers in place of Meshcat's random names: equal scenes give equal files.

    ``names`` are the numbers so far; a part is named where it has its ``uuid``, before or after its use.
    """

    def collect(value: Any) -> None:
        if isinstance(value, dict):
            if isinstance(value.get("uuid"), str):
                names.setdefault(value["uuid"], str(len(names)))
            for entry in value.values():
                collect(entry)
        elif isinstance(value, list):
            for entry in value:
                collect(entry)

    def renamed(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: renamed(entry) for key, entry in value.items()}
        if isinstance(value, list):
            return [renamed(entry) for entry in value]
        return names.get(value, value) if isinstance(value, str) else value

    if message["type"] != "set_object":
        return message
    collect(message["object"])
    return {**message, "object": renamed(message["object"])}


def _with_shared_meshes(message: dict[str, Any], meshes: dict[bytes, Any]) -> dict[str, Any]:
    """Return the message with the content of its geometries replaced by their place in ``meshes``."""

    def shared(part: dict[str, Any]) -> dict[str, Any]:
        if "data" not in part:
            return part
        key = hashlib.sha256(umsgpack.packb(part["data"])).digest()
        if key not in meshes:
            meshes[key] = compact_geometry(part) or part["data"]
        rest = {name: value for name, value in part.items() if name != "data"}
        return {**rest, "shared": list(meshes).index(key)}

    if message["type"] != "set_object":
        return message
    content = dict(message["object"])
    content["geometries"] = [shared(part) for part in content.get("geometries", [])]
    content["object"] = shared(content["object"])
    return {**message, "object": content}
