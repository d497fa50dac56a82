"""A headless Chromium that opens pages and takes pictures of them, spoken to by its DevTools protocol."""

from __future__ import annotations

import base64
import io
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

FLAGS = [
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars", "--no-first-run",
    "--disable-extensions", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
    "--remote-debugging-port=0",
]  # fmt: skip


def find():
    """Path of a Chromium or Chrome, or None. $SIGNORINI_BROWSER comes first."""
    names = [os.environ.get("SIGNORINI_BROWSER", ""), "chromium", "chromium-browser", "google-chrome", "chrome"]
    return next((path for name in names if name and (path := shutil.which(name))), None)


class Browser:
    def __init__(self, size=(1280, 800), *, offline=False):
        from websockets.sync.client import connect

        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        flags = [*FLAGS, f"--user-data-dir={self._profile.name}", f"--window-size={size[0]},{size[1]}"]
        if offline:  # only this machine is reached
            flags.append("--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE localhost, EXCLUDE 127.0.0.1")
        self._process = subprocess.Popen([find(), *flags, "about:blank"], stderr=subprocess.DEVNULL)
        self._numbers = itertools.count(1)
        self._connect = connect
        self._sockets = []
        where = Path(self._profile.name) / "DevToolsActivePort"
        wait_for(lambda: where.is_file() and len(where.read_text().splitlines()) == 2, 30)
        port, path = where.read_text().splitlines()
        self._address = f"ws://127.0.0.1:{port}"
        self._main = self._open(self._address + path)

    def _open(self, address):
        socket = self._connect(address, max_size=None, proxy=None, ping_interval=None)  # a busy Chromium answers late
        self._sockets.append(socket)
        return socket

    def page(self, url, size=(1280, 800), scale=1.0):
        target = self.call(self._main, "Target.createTarget", url="about:blank")["targetId"]
        page = Page(self, target, self._open(f"{self._address}/devtools/page/{target}"))
        page.call("Page.enable")
        page.call("Runtime.enable")
        page.call("Network.enable")
        page.call(
            "Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], deviceScaleFactor=scale, mobile=False
        )
        page.call("Page.navigate", url=url)
        return page

    def call(self, socket, method, events=None, **parameters):
        number = next(self._numbers)
        socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(socket.recv(timeout=60))
            if answer.get("id") == number:
                if "Not attached" in answer.get("error", {}).get("message", ""):  # between two documents
                    time.sleep(0.2)
                    return self.call(socket, method, events, **parameters)
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            if events is not None:
                events.append(answer)

    def close(self):
        for socket in self._sockets:
            socket.close()
        self._process.terminate()
        self._process.wait(20)
        self._profile.cleanup()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


class Page:
    def __init__(self, browser, target, socket):
        self._browser, self._target, self._socket = browser, target, socket
        self.events = []

    def call(self, method, **parameters):
        return self._browser.call(self._socket, method, self.events, **parameters)

    def evaluate(self, expression):
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def text(self):
        return self.evaluate("document.body.innerText") or ""

    def click(self, words):
        """On the button that says these words."""
        box = self._box(
            "[...document.querySelectorAll('button, label, [role=button]')]"
            f".find(b => b.innerText.trim() === {json.dumps(words)})"
        )
        assert box, f"there is no button {words!r}"
        self._press(box, 0.5)

    def place_of(self, selector):
        """Left, top, width, height of an element, or None."""
        return self._box(f"document.querySelector({json.dumps(selector)})")

    def press_at(self, selector, share):
        """Somewhere between the left and the right end of an element."""
        self._press(self.place_of(selector), share)

    def _box(self, element):
        return self.evaluate(
            f"(() => {{const e = {element}; if (!e) return null; const r = e.getBoundingClientRect();"
            "return [r.x, r.y, r.width, r.height];})()"
        )

    def _press(self, box, share):
        at = {"x": box[0] + share * box[2], "y": box[1] + 0.5 * box[3], "button": "left", "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type="mousePressed", **at)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", **at)

    def picture(self, file=None):
        """Pixels, (height, width, 3) of uint8."""
        from PIL import Image

        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if file is not None:
            Path(file).write_bytes(data)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))

    def requests(self):
        """Addresses that the page asked for."""
        self.evaluate("0")
        found = [e["params"]["request"]["url"] for e in self.events if e.get("method") == "Network.requestWillBeSent"]
        return [url for url in found if not url.startswith(("data:", "blob:"))]

    def errors(self):
        self.evaluate("0")
        return [e["params"]["exceptionDetails"] for e in self.events if e.get("method") == "Runtime.exceptionThrown"]

    def close(self):
        self._browser.call(self._browser._main, "Target.closeTarget", targetId=self._target)


def wait_for(condition, seconds):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.1)
