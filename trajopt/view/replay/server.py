"""Meshcat's server, with the page of a live replay at its own address, http://127.0.0.1:PORT/.

`trajopt.view.replay.show` runs this file as a process. It imports nothing of trajopt, so that it starts at
once, and it ends when its standard input does, i.e. with the process that started it, however that one ends.
Meshcat's own page stays where it was, at /static/.
"""

import asyncio
import os
import sys
import threading
from typing import Any

import tornado.web
from meshcat.servers import zmqserver
from meshcat.servers.tree import walk

HOST = "127.0.0.1"

# Messages besides those of Meshcat: ("page", "", HTML) and ("trajopt", path, msgpack). The last one of each
# path is also sent to browsers that connect later, after the scene.
PAGE, OWN = "page", "trajopt"


class PageOrSocket(zmqserver.WebSocketHandler):
    """The page for browsers that ask for one; the websocket for the page itself."""

    async def get(self, *args: Any, **kwargs: Any) -> None:
        """Answer with the page unless a websocket is requested."""
        if self.request.headers.get("Upgrade", "").lower() == "websocket":
            await super().get(*args, **kwargs)
            return
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.set_header("Cache-Control", "no-store")
        self.finish(self.bridge.page)

    def open(self, *args: str, **kwargs: str) -> None:
        """Send the present scene to a new browser."""
        self.bridge.websocket_pool.add(self)
        self.bridge.send_scene(self)

    def on_close(self) -> None:
        """Remove a browser that has disconnected."""
        self.bridge.websocket_pool.discard(self)


class Nothing(tornado.web.RequestHandler):
    """The tab icon that browsers request."""

    def get(self) -> None:
        """Answer that there is none."""
        self.set_status(204)


class LocalApplication(tornado.web.Application):
    """A server that only this machine can reach; Meshcat's listens on every network."""

    def listen(self, port: int, address: str | None = None, **options: Any) -> Any:
        """Take a port; raises `OSError` if it is not free."""
        return super().listen(port, address=address or HOST, **options)


class Bridge(zmqserver.ZMQWebSocketBridge):
    """Meshcat's server between Python and browsers, with a page."""

    def __init__(self) -> None:
        self.page = b""
        self.told: dict[str, bytes] = {}
        super().__init__(host=HOST)
        self.web_url = f"http://{self.host}:{self.fileserver_port}/"

    def make_app(self) -> tornado.web.Application:
        """Meshcat's addresses, and ours."""
        static = {"path": zmqserver.VIEWER_ROOT, "default_filename": zmqserver.VIEWER_HTML}
        return LocalApplication(
            [
                (r"/static/(.*)", zmqserver.StaticFileHandlerNoCache, static),
                (r"/favicon.ico", Nothing),
                (r"/", PageOrSocket, {"bridge": self}),
            ]
        )

    def handle_zmq(self, frames: list[bytes]) -> None:
        """Take one message from Python and answer it."""
        kind = frames[0].decode("utf-8")
        if kind not in (PAGE, OWN) or len(frames) != 3:
            super().handle_zmq(frames)
            return
        if kind == PAGE:
            self.page = frames[2]
        else:
            self.told[frames[1].decode("utf-8")] = frames[2]
            self.forward_to_websockets(frames)
        self.zmq_socket.send(b"ok")

    def send_scene(self, websocket: Any) -> None:
        """Send one browser everything: animations after the objects that they move."""
        nodes = list(walk(self.tree))
        for node in nodes:
            for data in (node.object, *node.properties, node.transform):
                if data is not None:
                    websocket.write_message(data, binary=True)
        for data in (*(node.animation for node in nodes), *self.told.values()):
            if data is not None:
                websocket.write_message(data, binary=True)


def serve_until_input_ends() -> None:
    """Serve until standard input ends."""
    if sys.platform == "win32":  # tornado needs this loop there
        asyncio.set_event_loop_policy(asyncio.WindowsSelectorEventLoopPolicy())

    def end_with_standard_input() -> None:
        sys.stdin.buffer.read()
        os._exit(0)

    bridge = Bridge()
    print(f"zmq_url={bridge.zmq_url}\nweb_url={bridge.web_url}", flush=True)
    threading.Thread(target=end_with_standard_input, daemon=True).start()
    bridge.run()


if __name__ == "__main__":
    serve_until_input_ends()
