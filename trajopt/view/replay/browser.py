"""A replay's page in a headless Chromium: seek, choose a camera, take pictures, collect its errors."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import io
import os
import shutil
import threading
from collections.abc import Awaitable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from trajopt.errors import InputError, TrajoptError, not_among

if TYPE_CHECKING:
    from playwright.async_api import Browser as AsyncBrowser
    from playwright.async_api import CDPSession, ConsoleMessage
    from playwright.async_api import Page as AsyncPage

_Answer = TypeVar("_Answer")

# Environment variable with the path of another Chromium or Chrome.
EXECUTABLE_VARIABLE = "TRAJOPT_CHROMIUM"
EXECUTABLES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
INSTALL_CHROMIUM = f"on Debian: apt install chromium; or set {EXECUTABLE_VARIABLE} to one"
INSTALL_EXTRA = "pip install playwright imageio-ffmpeg"
# Drawn through EGL: by a graphics card if there is one, by Mesa on the processor if not, and where EGL is
# missing by Chromium's own SwiftShader, which takes over by itself and is half as fast. The page is our own
# file without network, and Chromium's sandbox does not start in containers.
FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=gl-egl",
    "--ignore-gpu-blocklist",
    "--enable-unsafe-swiftshader",
)
# Time limits, s: until an opened page is ready, for one call, and for the end of the browser.
READY_LIMIT, CALL_LIMIT, END_LIMIT = 90.0, 120.0, 10.0
# Kinds of console message that count as errors.
COMPLAINTS = ("error", "warning", "assert")
# Chromium's own message about taking pictures without a graphics card.
DRIVER_MESSAGE = "GL Driver Message"
# Opens a page paused at its start (earlier times are clipped).
AT_START = "t=0"


class _Calls:
    """A thread with an event loop that runs Playwright: calls from any thread, with time limits.

    Playwright's own blocking interface has no limit for some calls and refuses to run in notebooks.
    """

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="browser", daemon=True)
        self._thread.start()

    def __call__(self, work: Awaitable[_Answer], limit: float, what: str) -> _Answer:
        """Return the result of ``work``; raises `TrajoptError`, one line, if it fails or takes too long."""
        from playwright.async_api import Error

        async def limited() -> _Answer:
            return await asyncio.wait_for(work, limit)

        try:
            return asyncio.run_coroutine_threadsafe(limited(), self._loop).result()
        except TimeoutError:
            raise TrajoptError(f"{what}: no answer from Chromium within {limit:g} s") from None
        except Error as error:
            raise TrajoptError(f"{what}: {_reason(error)}") from None

    def end(self) -> None:
        """Stop the thread."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


class OpenedPage:
    """A page of `trajopt.replay`, paused in Chromium.

    Attributes:
        start, duration: of the solution, s.
        cameras, layers: their names.
        errors: messages so far: errors and warnings of the console, exceptions of scripts.
        requests: addresses that the page has requested.

    Every method raises `TrajoptError`, one line, if the browser crashes or does not answer in time.
    """

    def __init__(self, calls: _Calls, page: AsyncPage, cdp: CDPSession, heard: _Heard) -> None:
        self._calls, self._page, self._cdp = calls, page, cdp
        self.errors, self.requests = heard.errors, heard.requests
        known = "(({start, duration, cameras, layers}) => ({start, duration, cameras, layers}))(trajopt)"
        facts = self.evaluate(known)
        self.start, self.duration = float(facts["start"]), float(facts["duration"])
        self.cameras, self.layers = tuple(facts["cameras"]), tuple(facts["layers"])

    def evaluate(self, script: str, argument: Any = None) -> Any:
        """Return what a JavaScript expression, or a function of ``argument``, gives in the page."""
        return self._calls(self._page.evaluate(script, argument), CALL_LIMIT, "the replay's page")

    def seek(self, t: float) -> None:
        """Show the time ``t`` (s of the solution); the page stays paused there."""
        self.evaluate("t => { trajopt.pause(); trajopt.seek(t); trajopt.render(); }", float(t))

    def camera(self, name: str) -> None:
        """Choose one of ``cameras``; raises `InputError` for another name."""
        _require_known("camera", name, self.cameras)
        self.evaluate("name => { trajopt.camera(name); trajopt.render(); }", name)

    def layer(self, name: str, visible: bool) -> None:
        """Show or hide one of ``layers``; raises `InputError` for another name."""
        _require_known("layer", name, self.layers)
        self.evaluate("([name, on]) => { trajopt.layer(name, on); trajopt.render(); }", [name, visible])

    def state(self) -> dict[str, Any]:
        """Return time (s of the solution), playing, phase, camera and number of pictures drawn."""
        return dict(self.evaluate("trajopt.state()"))

    def png(self) -> bytes:
        """Return the window's picture as a lossless PNG, in the size in which it was opened."""
        # Weak compression, for speed: the picture is passed on to Pillow or ffmpeg.
        shot = self._cdp.send("Page.captureScreenshot", {"format": "png", "optimizeForSpeed": True})
        return base64.b64decode(self._calls(shot, CALL_LIMIT, "a picture of the replay's page")["data"])

    def picture(self) -> np.ndarray:
        """Return the window's picture: bytes (h, w, 3) of red, green and blue."""
        from PIL import Image

        return np.array(Image.open(io.BytesIO(self.png())).convert("RGB"))


def _require_known(kind: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        raise not_among(known, name, f"{kind} '{name}' is unknown")


class _Heard:
    """A page's messages and requests."""

    def __init__(self) -> None:
        self.errors: list[str] = []
        self.requests: list[str] = []

    def listen(self, page: AsyncPage) -> None:
        page.on("console", self._console)
        page.on("pageerror", lambda error: self.errors.append(f"exception: {_first_line(str(error))}"))
        page.on("crash", lambda _: self.errors.append("crash: the page's process has ended"))
        page.on("request", lambda request: self.requests.append(request.url))

    def failures(self) -> list[str]:
        """Messages other than warnings."""
        return [text for text in self.errors if not text.startswith("warning")]

    def _console(self, message: ConsoleMessage) -> None:
        if message.type in COMPLAINTS and DRIVER_MESSAGE not in message.text:
            self.errors.append(f"{message.type}: {_first_line(message.text)}")


class Chromium:
    """A running headless Chromium, without network, that opens pages."""

    def __init__(self, calls: _Calls, browser: AsyncBrowser) -> None:
        self._calls, self._browser = calls, browser

    @contextlib.contextmanager
    def opened(
        self,
        page: str | Path,
        size: tuple[int, int] = (1280, 720),
        fragment: str = AT_START,
        limit: float = READY_LIMIT,
    ) -> Iterator[OpenedPage]:
        """Open a replay's ``page`` in a window of ``size`` (width, height) pixels.

        ``fragment`` is the part after # in its address, as in ``"t=0.3&camera=side&panel=off"``: the page is
        paused at time ``t`` and plays without it. Raises `InputError` for a file that does not exist and
        `TrajoptError` for a page that is not ready within ``limit`` s.
        """
        path = Path(page).absolute()
        if not path.is_file():
            raise InputError(f"page {path} does not exist", "a page that trajopt.replay has written")
        heard, what = _Heard(), f"page {path.name}"
        address = path.as_uri() + (f"#{fragment}" if fragment else "")
        # The work has the limit itself, and reports the page's errors.
        view, cdp = self._calls(_open(self._browser, address, size, heard, limit), limit + END_LIMIT, what)
        try:
            yield OpenedPage(self._calls, view, cdp, heard)
        finally:
            with contextlib.suppress(TrajoptError):  # the browser may be gone
                self._calls(view.context.close(), END_LIMIT, what)


@contextlib.contextmanager
def chromium() -> Iterator[Chromium]:
    """Start a headless Chromium, and stop it at the end whatever happens.

    Raises `InputError`, one line that says what to install, if Chromium or Playwright is missing, and
    `TrajoptError` if Chromium does not start.
    """
    executable = require_chromium()
    from playwright.async_api import async_playwright

    calls, manager = _Calls(), async_playwright()
    try:
        driver = calls(manager.__aenter__(), READY_LIMIT, "playwright")
        launching = driver.chromium.launch(
            executable_path=executable,
            headless=True,
            args=list(FLAGS),
            handle_sigint=False,  # Ctrl-C is handled here, at the end of this function
        )
        try:
            yield Chromium(calls, calls(launching, READY_LIMIT, executable))
        finally:
            with contextlib.suppress(TrajoptError):
                calls(manager.__aexit__(), END_LIMIT, "playwright")  # ends the browser too
    finally:
        calls.end()


@contextlib.contextmanager
def open_page(page: str | Path, *how: Any, **options: Any) -> Iterator[OpenedPage]:
    """Open one page in a separate Chromium, as `Chromium.opened`."""
    with chromium() as browser, browser.opened(page, *how, **options) as view:
        yield view


def require_chromium() -> str:
    """Return the Chromium to use; raises `InputError`, one line, if it or Playwright is missing."""
    try:
        import playwright.async_api  # noqa: F401
    except ImportError:
        raise InputError("pictures of a replay need playwright", INSTALL_EXTRA) from None
    return find_chromium()


def find_chromium() -> str:
    """Return the Chromium or Chrome to use; raises `InputError` if there is none."""
    given = os.environ.get(EXECUTABLE_VARIABLE)
    program = next(filter(None, map(shutil.which, [given] if given else EXECUTABLES)), None)
    if program is not None:
        return program
    if given:
        raise InputError(f"{EXECUTABLE_VARIABLE} is {given}, which is no program", INSTALL_CHROMIUM)
    raise InputError("pictures of a replay need Chromium, which is not installed", INSTALL_CHROMIUM)


async def _open(
    browser: AsyncBrowser, address: str, size: tuple[int, int], heard: _Heard, limit: float
) -> tuple[AsyncPage, CDPSession]:
    """Open a page in a separate window; raises `TrajoptError` with the page's error if it is not ready."""
    width, height = size
    context = await browser.new_context(
        viewport={"width": width, "height": height}, device_scale_factor=1, offline=True
    )
    try:
        page = await context.new_page()
        heard.listen(page)
        await asyncio.wait_for(_ready(page, address, heard), limit)
        return page, await context.new_cdp_session(page)
    except TimeoutError:
        await context.close()
        said = f"; it says: {heard.failures()[0]}" if heard.failures() else ""
        raise TrajoptError(f"page {address} is not ready after {limit:g} s{said}") from None
    except BaseException:
        await context.close()
        raise


async def _ready(page: AsyncPage, address: str, heard: _Heard) -> None:
    """Load the page and wait until it has drawn; raises `TrajoptError` if its script is missing or fails."""
    await page.goto(address, wait_until="load", timeout=0)
    # Scripts in a page run before its load ends.
    if not await page.evaluate("typeof trajopt !== 'undefined'"):
        failed = heard.failures() or ["it is not of trajopt replay, or of another version"]
        raise TrajoptError(f"page {address} does not start: {failed[0]}")
    await page.evaluate("trajopt.ready.then(() => true)")


def _reason(error: Exception) -> str:
    """One line of Playwright's message, which may contain a log: the cause, if it is stated."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    telling = [line for line in lines if "error while loading" in line or "No usable sandbox" in line]
    return (telling or lines or ["Chromium has ended"])[0]


def _first_line(text: str) -> str:
    return next(iter(text.strip().splitlines()), "")
