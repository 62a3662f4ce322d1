"""The web server of a drive, in a thread: its page, a websocket for what is drawn, and commands by POST.

It listens on the loopback interface only. Commands must be JSON, which pages of other origins cannot send,
and requests for other host names are refused.
"""

from __future__ import annotations

import asyncio
import html
import json
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any

import tornado.web
import tornado.websocket
import umsgpack
from tornado.httpserver import HTTPServer
from typing_extensions import override

from trajopt.errors import InputError, without_nonfinite
from trajopt.view.replay.commands import ViewerCommand
from trajopt.view.replay.server import HOST, OWN, Nothing

# Ports tried by default, and the largest port number.
PORTS, LAST_PORT = range(7000, 7100), 65535
# Largest command in bytes, and time limit for stopping the server, s.
LONGEST, END = 10_000, 5.0
JSON = "application/json"
# The page while a drive is prepared: it is loaded anew each second.
WAITING = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta http-equiv="refresh" content="1"><title>Preparing</title>
<style>body {{ font: 1.2rem sans-serif; margin: 4rem; }}</style></head>
<body><p>Preparing {}.</p><p>The page appears when it is ready.</p></body></html>
"""


class DriveServer:
    """Serves the page of a drive; until `show`, one that says what is prepared and loads the other by itself.

    Args:
        port: to listen on; default: the first free one of `PORTS`.
        prepared: what is prepared until then.

    Raises:
        InputError: for a port that is taken or not allowed.
    """

    def __init__(self, port: int | None = None, prepared: str = "the drive") -> None:
        if port is not None and not 0 < port <= LAST_PORT:
            raise InputError(f"port is {port}", f"allowed: 1 to {LAST_PORT}")
        self.page, self.scene = WAITING.format(html.escape(prepared)), list[bytes]()
        self.obey: Callable[[Any], None] = _nothing_yet
        self.latest: dict[str, bytes] = {}
        self.browsers: set[_Browser] = set()
        self._loop, started = asyncio.new_event_loop(), Future[int]()
        self._thread = threading.Thread(target=self._serve, args=(started, port), daemon=True)
        self._thread.start()
        self.port = started.result()
        self.url = f"http://{HOST}:{self.port}/"

    def show(self, page: str, scene: Sequence[ViewerCommand], obey: Callable[[Any], None]) -> None:
        """Serve a page; callable from any thread.

        Args:
            page: its HTML.
            scene: commands that are sent to each browser first.
            obey: called in the server's thread with the decoded JSON of a command; may raise `InputError`.
        """
        self.scene, self.obey = [umsgpack.packb(command.lower()) for command in scene], obey
        self.page = page

    def tell(self, path: str, value: Any) -> None:
        """Send a value to all browsers, from any thread; later ones get the latest value of each path.

        The value is sent as JSON, which takes a tenth of the time of Meshcat's format.
        """
        text = json.dumps(without_nonfinite(value), allow_nan=False)
        data = umsgpack.packb({"type": OWN, "path": path, "value": text})
        self._loop.call_soon_threadsafe(self._tell, path, data)

    def close(self) -> None:
        """Stop the server; does nothing if it has stopped."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(END)

    def _tell(self, path: str, data: bytes) -> None:
        self.latest[path] = data
        for browser in self.browsers:
            browser.tell(data)

    def _serve(self, started: Future[int], port: int | None) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            server, used = self._listen(port)
        except BaseException as error:
            started.set_exception(error)
            return
        started.set_result(used)
        self._loop.run_forever()
        server.stop()
        for browser in tuple(self.browsers):
            browser.close()
        self._loop.run_until_complete(server.close_all_connections())
        self._loop.close()

    def _listen(self, port: int | None) -> tuple[HTTPServer, int]:
        application = tornado.web.Application(log_function=lambda handler: None)
        handlers: list[Any] = [
            (r"/", _Browser, {"server": self}),
            (r"/command", _Command, {"server": self}),
            (r"/favicon.ico", Nothing),
        ]
        application.add_handlers(r"(127\.0\.0\.1|localhost)", handlers)
        server = HTTPServer(application, max_body_size=LONGEST)
        for each in PORTS if port is None else (port,):
            try:
                server.listen(each, HOST)
            except OSError:
                continue
            return server, each
        taken = f"port {port} is taken" if port else f"no port from {PORTS.start} to {PORTS.stop - 1} is free"
        raise InputError(taken, "allowed: a free port")


def _nothing_yet(wanted: Any) -> None:
    raise InputError("the robot is not ready", "allowed: a command to a page that is shown")


class _Browser(tornado.websocket.WebSocketHandler):
    """Serves the page to a browser, and the page's data through a websocket."""

    @override
    def initialize(self, server: DriveServer) -> None:
        self.server = server
        self._sent: asyncio.Future[None] | None = None

    async def get(self, *args: Any, **kwargs: Any) -> None:
        if self.request.headers.get("Upgrade", "").lower() == "websocket":
            await super().get(*args, **kwargs)
            return
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.set_header("Cache-Control", "no-store")
        self.finish(self.server.page)

    @override
    def open(self, *args: str, **kwargs: str) -> None:
        for data in (*self.server.scene, *self.server.latest.values()):
            self.write_message(data, binary=True)
        self.server.browsers.add(self)

    @override
    def on_message(self, message: str | bytes) -> None:
        """Ignore messages: Meshcat's viewer sends pictures unasked."""

    @override
    def on_close(self) -> None:
        self.server.browsers.discard(self)

    def tell(self, data: bytes) -> None:
        """Send a message, or drop it if the last one is still being sent."""
        if self._sent is None or self._sent.done():
            self._sent = asyncio.ensure_future(self._send(data))

    async def _send(self, data: bytes) -> None:
        try:
            await self.write_message(data, binary=True)
        except tornado.websocket.WebSocketClosedError:
            self.server.browsers.discard(self)


class _Command(tornado.web.RequestHandler):
    """Takes a command by POST; answers 204, or 400 with a reason of one line."""

    @override
    def initialize(self, server: DriveServer) -> None:
        self.server = server

    def post(self) -> None:
        try:
            if self.request.headers.get("Content-Type", "").partition(";")[0].strip().lower() != JSON:
                raise InputError("a command is of another content type", f"allowed: {JSON}")
            try:
                wanted = json.loads(self.request.body)
            except (ValueError, RecursionError):
                raise InputError("a command is not JSON", "allowed: an object") from None
            self.server.obey(wanted)
        except InputError as error:
            self.set_status(400)
            self.set_header("Content-Type", "text/plain; charset=utf-8")
            self.finish(" ".join(str(error).split()) + "\n")
            return
        self.set_status(204)
