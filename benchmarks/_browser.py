"""A page in headless Chromium: what it asks the network for, and what goes wrong."""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from select import select
from typing import Any, NamedTuple

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
"""Names of the browser."""

LONGEST_S, SETTLED_S = 60.0, 2.0
"""Time for a page to load, and after which nothing more is expected of it [s]."""


class NoBrowser(RuntimeError):
    """There is no Chromium on this machine."""


class Visit(NamedTuple):
    """What a page did while it loaded.

    Attributes:
        requests: Addresses that it asked for, besides its own and those within it.
        errors: Errors of its console, uncaught ones too.
    """

    requests: tuple[str, ...]
    errors: tuple[str, ...]


def browser() -> str:
    """Path of the browser.

    Raises:
        NoBrowser: If there is none.
    """
    path = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if path is None:
        raise NoBrowser(
            f"this needs one of {', '.join(PROGRAMS)}: apt-get install chromium"
        )
    return path


def visit(page: Path) -> Visit:
    """Open a page from disk and wait until it has settled.

    Args:
        page: An HTML file.

    Raises:
        NoBrowser: If there is no browser.
        RuntimeError: If it does not load the page.
    """
    with opened(page) as tab:
        return tab.loaded


@contextmanager
def opened(page: Path, *, webgl: bool = True) -> Iterator["Tab"]:
    """Open a page from disk, wait until it has settled, and keep it open.

    Args:
        page: An HTML file.
        webgl: Whether the browser draws in three dimensions.

    Raises:
        NoBrowser: If there is no browser.
        RuntimeError: If it does not load the page.
    """
    more = () if webgl else ("--disable-3d-apis",)
    with _started(browser(), *more) as chromium:
        target = chromium.call("Target.createTarget", url="about:blank")["targetId"]
        attach = {"targetId": target, "flatten": True}
        session = chromium.call("Target.attachToTarget", **attach)["sessionId"]
        yield Tab(chromium, session, page.resolve().as_uri())


class Tab:
    """A page that has loaded and settled.

    Attributes:
        loaded: What it did meanwhile.
    """

    def __init__(self, chromium: "_Chromium", session: str, address: str):
        """Load the page."""
        self._chromium, self._session = chromium, session
        requests, errors = [], []
        for domain in ("Network", "Runtime", "Log", "Page"):
            self._call(f"{domain}.enable")
        reply = self._call("Page.navigate", url=address)
        if "errorText" in reply:
            raise RuntimeError(f"{address}: {reply['errorText']}")
        for event, about in chromium.events():
            if event == "Network.requestWillBeSent":
                url = about["request"]["url"]
                if url != address and not url.startswith(("data:", "blob:")):
                    requests.append(url)
            elif event == "Runtime.exceptionThrown":
                errors.append(about["exceptionDetails"]["text"])
            elif event == "Runtime.consoleAPICalled" and about["type"] == "error":
                values = (str(arg.get("value", arg)) for arg in about["args"])
                errors.append(" ".join(values))
            elif event == "Log.entryAdded" and about["entry"]["level"] == "error":
                errors.append(about["entry"]["text"])
        self.loaded = Visit(tuple(requests), tuple(errors))

    def resize(self, width: int, height: int = 900) -> None:
        """Show the page in a window of another size [px]."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1}
        self._call("Emulation.setDeviceMetricsOverride", **size, mobile=width < 600)

    def print(self, on: bool = True) -> None:
        """Show the page as it is printed, or on a screen again."""
        self._call("Emulation.setEmulatedMedia", media="print" if on else "screen")

    def ask(self, expression: str) -> Any:
        """Evaluate an expression of JavaScript in the page.

        Args:
            expression: Its value, or what it promises, is as JSON can say it.

        Raises:
            RuntimeError: If it fails.
        """
        how = {"awaitPromise": True, "returnByValue": True}
        reply = self._call("Runtime.evaluate", expression=expression, **how)
        if "exceptionDetails" in reply:
            about = reply["exceptionDetails"]
            said = about.get("exception", {}).get("description", about["text"])
            raise RuntimeError(f"the page could not answer: {said}")
        return reply["result"].get("value")

    def screenshot(self, selector: str) -> bytes:
        """Draw an element, however long it is, as a PNG.

        Args:
            selector: The first element that matches it, of CSS.
        """
        place = self.ask(
            f"(({{x, y, width, height}}) => ({{x: x + scrollX, y: y + scrollY, width, "
            f"height, scale: 1}}))(document.querySelector({json.dumps(selector)})"
            ".getBoundingClientRect())"
        )
        how = {"format": "png", "captureBeyondViewport": True, "clip": place}
        return base64.b64decode(self._call("Page.captureScreenshot", **how)["data"])

    def _call(self, method: str, **about: Any) -> Any:
        return self._chromium.call(method, session=self._session, **about)


class _Chromium:
    """The DevTools protocol over pipes: one JSON text after the other, ended by NUL."""

    def __init__(self, to: int, back: int):
        self._to, self._back = to, back
        self._n, self._buffer = 0, b""
        self._waiting: list[dict[str, Any]] = []

    def call(self, method: str, *, session: str | None = None, **about: Any) -> Any:
        """Call a method and return its result; events wait meanwhile."""
        self._n += 1
        message = {"id": self._n, "method": method, "params": about}
        message |= {"sessionId": session} if session else {}
        os.write(self._to, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + LONGEST_S
        while (reply := self._next(deadline)) is not None:
            if reply.get("id") == self._n:
                if "error" in reply:
                    raise RuntimeError(f"{method}: {reply['error']}")
                return reply["result"]
            self._waiting.append(reply)
        raise RuntimeError(f"Chromium did not answer {method} in {LONGEST_S:g} s.")

    def events(self) -> Iterator[tuple[str, Mapping[str, Any]]]:
        """Yield events until the page has loaded, and a while longer.

        Raises:
            RuntimeError: If it does not load.
        """
        deadline, loaded = time.monotonic() + LONGEST_S, False
        while True:
            message = self._waiting.pop(0) if self._waiting else self._next(deadline)
            if message is None:
                if loaded:
                    return
                raise RuntimeError(f"the page did not load in {LONGEST_S:g} s.")
            if message.get("method") == "Page.loadEventFired":
                deadline, loaded = time.monotonic() + SETTLED_S, True
            if "method" in message:
                yield message["method"], message["params"]

    def _next(self, deadline: float) -> dict[str, Any] | None:
        """Read a message; None if there is none before the deadline."""
        while b"\0" not in self._buffer:
            left = deadline - time.monotonic()
            if left <= 0.0 or not select([self._back], [], [], left)[0]:
                return None
            read = os.read(self._back, 1 << 16)
            if not read:
                raise RuntimeError("Chromium ended.")
            self._buffer += read
        text, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(text)


@contextmanager
def _started(program: str, *more: str) -> Iterator[_Chromium]:
    """Start Chromium with a profile of its own and more options, and end it."""
    inner_read, to = os.pipe()
    back, inner_write = os.pipe()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        # It reads from descriptor 3 and writes to 4.
        command = f'exec "$0" "$@" 3<&{inner_read} 4>&{inner_write}'
        options = ["--headless=new", "--no-sandbox", "--disable-gpu-sandbox"]
        options += ["--remote-debugging-pipe", f"--user-data-dir={profile}"]
        options += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        options += ["--hide-scrollbars", *more]
        process = subprocess.Popen(
            ["bash", "-c", command, program, *options],
            pass_fds=(inner_read, inner_write),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(inner_read)
        os.close(inner_write)
        try:
            yield _Chromium(to, back)
        finally:
            process.terminate()
            process.wait()
            os.close(to)
            os.close(back)
