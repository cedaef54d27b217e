"""A headless browser that opens a file, and what happens in it."""

import asyncio
import contextlib
import json
import os
import shutil
import subprocess
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest

# A browser of this family, wherever it is called what.
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
# WebGL is drawn by the processor.
OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--remote-debugging-port=0",
)

# Seconds after which the browser is given up.
PATIENCE = 300.0


class Tab:
    """A page of the browser, over its debugging protocol."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._count = socket, 0
        self.events: list[dict[str, Any]] = []

    async def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol and return its result; keep the events on the way."""
        self._count += 1
        message = {"id": self._count, "method": method, "params": parameters}
        await self._socket.write_message(json.dumps(message))
        while True:
            got = json.loads(await asyncio.wait_for(self._socket.read_message(), PATIENCE))
            if got.get("id") == self._count:
                assert "error" not in got, got
                result: dict[str, Any] = got["result"]
                return result
            self.events.append(got)

    async def value(self, expression: str) -> Any:
        """Return the value of a JavaScript expression."""
        found = await self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    async def key(self, key: str) -> None:
        """Press a key."""
        for kind in ("rawKeyDown", "keyUp"):
            await self.call("Input.dispatchKeyEvent", type=kind, key=key)

    async def fits(self, width: int) -> None:
        """Give the page a width, and check that nothing stands beside it."""
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        await self.call("Emulation.setDeviceMetricsOverride", **size)
        assert await self.value("document.documentElement.scrollWidth") <= width

    async def until(self, condition: str) -> None:
        """Wait until a JavaScript expression is true."""
        end = time.monotonic() + PATIENCE
        while not await self.value(condition):
            assert time.monotonic() < end, condition
            await asyncio.sleep(0.05)

    def named(self, *methods: str) -> list[dict[str, Any]]:
        """Return the events of some kinds."""
        return [event for event in self.events if event.get("method") in methods]

    def heard_nothing(self) -> None:
        """Check that the page met no error and fetched nothing."""
        assert not self.named("Runtime.exceptionThrown", "Runtime.consoleAPICalled")
        assert not self.named("Log.entryAdded")
        asked = [e["params"]["request"]["url"] for e in self.named("Network.requestWillBeSent")]
        assert all(url.startswith(("file:", "data:")) for url in asked)


def look(path: Path, profile: Path, visit: Callable[[Tab], Awaitable[None]]) -> None:
    """Open a file in a browser and visit it; skip the test where there is no browser.

    Parameters
    ----------
    path : Path
        An HTML file.
    profile : Path
        Empty folder for the browser.
    visit : callable
        Called with the tab after the page was loaded.
    """
    program = os.environ.get("SDPID_BROWSER") or next(filter(None, map(shutil.which, BROWSERS)), "")
    if not program:
        pytest.skip(f"no browser: none of {', '.join(BROWSERS)} is installed")
    pytest.importorskip("tornado")

    async def run() -> None:
        async with _tab(program, profile) as tab:
            for domain in ("Page", "Runtime", "Log", "Network"):
                await tab.call(f"{domain}.enable")
            await tab.call("Page.navigate", url=path.resolve().as_uri())
            await tab.until("document.readyState === 'complete'")
            await visit(tab)

    asyncio.run(run())


@contextlib.asynccontextmanager
async def _tab(program: str, profile: Path) -> AsyncIterator[Tab]:
    from tornado.websocket import websocket_connect

    arguments = [program, *OPTIONS, f"--user-data-dir={profile}", "about:blank"]
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(arguments, **silent) as process:
        try:
            port = profile / "DevToolsActivePort"
            end = time.monotonic() + PATIENCE
            while not (port.is_file() and port.read_text().count("\n")):
                assert time.monotonic() < end, "the browser does not start"
                await asyncio.sleep(0.05)
            address = f"http://127.0.0.1:{port.read_text().splitlines()[0]}/json/list"
            with urlopen(address, timeout=PATIENCE) as answer:
                pages = [each for each in json.load(answer) if each["type"] == "page"]
            socket = await websocket_connect(pages[0]["webSocketDebuggerUrl"])
            try:
                yield Tab(socket)
            finally:
                socket.close()
                while await asyncio.wait_for(socket.read_message(), PATIENCE) is not None:
                    pass
        finally:
            process.terminate()
