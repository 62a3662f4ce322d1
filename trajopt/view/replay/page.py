"""One HTML page with a complete replay: the viewer's code, the meshes and the animation."""

import base64
import gzip
import hashlib
import html
import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from string import Template
from typing import Any

import meshcat
import umsgpack

from trajopt.errors import TrajoptError, without_nonfinite
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


@dataclass(frozen=True, kw_only=True)
class PageSource:
    """Files of a page: what its body shows, in HTML, styles, and scripts in order of dependency."""

    body: Path
    styles: tuple[Path, ...]
    scripts: tuple[Path, ...]


REPLAY = PageSource(
    body=WEB / "player.html", styles=(WEB / "page.css",), scripts=tuple(WEB / name for name in SCRIPTS)
)


def page(scene: ReplayScene) -> str:
    """Return the text of the page.

    Raises `TrajoptError` if Meshcat's viewer is not fully installed.
    """
    return _text(REPLAY, {**scene.facts, "live": False}, ALONE, packed_scene(scene))


def live_page(facts: dict[str, Any], source: PageSource = REPLAY) -> str:
    """Return the text of a page that receives its scene from its server."""
    return _text(source, {**facts, "live": True}, LIVE, b"")


def _text(source: PageSource, facts: dict[str, Any], allowed: dict[str, str], scene: bytes) -> str:
    code = "\n".join(path.read_text(encoding="utf-8") for path in source.scripts)
    player = f'\n(() => {{\n"use strict";\n{code}}})();\n'  # isolated from the rest of the page
    digest = _base64(hashlib.sha256(player.encode()).digest())
    viewer, licence = _viewer()
    return Template((WEB / "page.html").read_text(encoding="utf-8")).substitute(
        body=source.body.read_text(encoding="utf-8"),
        policy=POLICY.format(player=digest, **allowed),
        title=html.escape(facts["title"]),
        style="\n".join(path.read_text(encoding="utf-8") for path in source.styles),
        licence=licence,
        viewer=viewer,
        scene=_base64(scene),
        # Escaped, so that the text cannot end its script element.
        facts=json.dumps(without_nonfinite(facts), allow_nan=False).replace("<", "\\u003c"),
        player=player,
    )


@cache
def _viewer() -> tuple[str, str]:
    """Meshcat's viewer, compressed, and its licence."""
    try:
        code = VIEWER.read_bytes()
        licence = VIEWER.with_name(VIEWER.name + ".LICENSE.txt").read_text(encoding="utf-8")
    except OSError as error:
        raise TrajoptError(f"Meshcat's viewer cannot be read: {error}") from None
    return _base64(gzip.compress(code, compresslevel=9, mtime=0)), licence.replace("</", "<\\/")


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")


def packed_scene(scene: ReplayScene) -> bytes:
    """Return the scene as compressed msgpack: ``{"meshes": [...], "commands": [...]}``, each mesh once."""
    meshes: dict[bytes, Any] = {}
    names: dict[str, str] = {}
    commands = []
    for command in scene.commands:
        message = command.lower()
        if message["type"] == "set_object":
            content = _with_shared_meshes(_numbered(message["object"], names), meshes)
            message = {**message, "object": content}
        commands.append(message)
    content = {"meshes": list(meshes.values()), "commands": commands}
    data = umsgpack.packb(content, force_float_precision="single")
    return gzip.compress(data, compresslevel=COMPRESSION, mtime=0)


def _numbered(content: dict[str, Any], names: dict[str, str]) -> dict[str, Any]:
    """Return an object with numbers in place of Meshcat's random names: equal scenes give equal files.

    ``names`` are the numbers so far; a part is named where it has its ``uuid``, before or after its use.
    """

    def collect(value: Any) -> None:
        if isinstance(value, dict):
            if isinstance(value.get("uuid"), str):
                names.setdefault(value["uuid"], str(len(names)))
            value = list(value.values())
        for entry in value if isinstance(value, list) else ():
            collect(entry)

    def renamed(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: renamed(entry) for key, entry in value.items()}
        if isinstance(value, list):
            return [renamed(entry) for entry in value]
        return names.get(value, value) if isinstance(value, str) else value

    collect(content)
    return renamed(content)


def _with_shared_meshes(content: dict[str, Any], meshes: dict[bytes, Any]) -> dict[str, Any]:
    """Return an object with the content of its geometries replaced by their place in ``meshes``."""

    def shared(part: dict[str, Any]) -> dict[str, Any]:
        if "data" not in part:
            return part
        key = hashlib.sha256(umsgpack.packb(part["data"])).digest()
        if key not in meshes:
            meshes[key] = compact_geometry(part) or part["data"]
        rest = {name: value for name, value in part.items() if name != "data"}
        return {**rest, "shared": list(meshes).index(key)}

    geometries = [shared(part) for part in content.get("geometries", [])]
    return {**content, "geometries": geometries, "object": shared(content["object"])}
