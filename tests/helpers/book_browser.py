"""What is wrong with built HTML pages, found by opening them in a browser."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, ConsoleMessage, Page, Request

WIDTHS = (1280, 390)
"""A desktop and a telephone, in CSS pixels."""

SETTLED = """async () => {
  if (window.MathJax && window.MathJax.startup) await window.MathJax.startup.promise;
  const loaded = (film) => film.readyState >= 1 || film.error || new Promise((resolve) => {
    film.addEventListener("loadedmetadata", resolve);
    film.querySelectorAll("source").forEach((one, i, all) => {
      if (i === all.length - 1) one.addEventListener("error", resolve);
    });
  });
  await Promise.all([...document.querySelectorAll("video")].map(loaded));
}"""

STATE = """() => ({
  formulas: document.querySelectorAll("article mjx-container").length,
  errors: [...document.querySelectorAll("[data-mjx-error], [data-mml-node=merror]")].map(
    (one) => one.getAttribute("data-mjx-error") || one.textContent),
  pictures: [...document.images].filter((one) => !one.closest("video"))
    .filter((one) => !one.complete || !one.naturalWidth || !one.naturalHeight)
    .map((one) => one.getAttribute("src")),
  films: [...document.querySelectorAll("video")].filter((one) => !(one.videoWidth > 0))
    .map((one) => one.currentSrc || "video"),
})"""

OVERFLOW = """() => {
  const root = document.documentElement, room = root.clientWidth + 1;
  const scrolls = (one) => one && one !== document.body && one !== root &&
    (["auto", "scroll"].includes(getComputedStyle(one).overflowX) || scrolls(one.parentElement));
  const wide = [...document.querySelectorAll("article *")]
    .filter((one) => one.getBoundingClientRect().right > room && !scrolls(one.parentElement))
    .filter((one) => !one.closest("mjx-assistive-mml"))
    .map((one) => `${one.tagName.toLowerCase()}.${one.getAttribute("class") || ""}`);
  return root.scrollWidth > room ? ["the page", ...wide] : wide;
}"""


@dataclass
class Watch:
    """Listens to a tab for what must not happen."""

    tab: Page
    origin: str
    """Beginning of every address that belongs to the site."""
    faults: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.tab.on("console", self._console)
        self.tab.on("pageerror", lambda error: self.faults.append(f"error in a script: {error}"))
        self.tab.on("request", self._request)
        self.tab.on("requestfailed", self._failed)

    def _console(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.faults.append(f"console error: {message.text}")

    def _request(self, request: Request) -> None:
        if not request.url.startswith((self.origin, "data:", "blob:")):
            self.faults.append(f"request to elsewhere: {request.url}")

    def _failed(self, request: Request) -> None:
        # A browser gives up the rest of a film once it knows enough of it.
        if request.resource_type != "media":
            self.faults.append(f"failed request: {request.url}")

    def open(self, address: str, formulas: int) -> list[str]:
        """Open a page with so many formulas at all widths; return its faults."""
        self.faults.clear()
        self.tab.set_viewport_size({"width": WIDTHS[0], "height": 900})
        self.tab.goto(self.origin + address)
        self.tab.evaluate(SETTLED)
        self.faults.extend(state_faults(self.tab.evaluate(STATE), formulas))
        for width in WIDTHS:
            self.tab.set_viewport_size({"width": width, "height": 900})
            wide = self.tab.evaluate(OVERFLOW)
            self.faults.extend(f"wider than {width} px: {one}" for one in wide)
        return [f"{address}: {fault}" for fault in self.faults]


def state_faults(state: dict[str, Any], formulas: int) -> list[str]:
    """Faults of a page's state in the browser."""
    faults = [f"formula: {error}" for error in state["errors"]]
    faults += [f"picture without pixels: {source}" for source in state["pictures"]]
    faults += [f"film does not load: {source}" for source in state["films"]]
    if state["formulas"] != formulas:
        faults.append(f"{state['formulas']} of {formulas} formulas typeset")
    return faults


@contextmanager
def tab(browser: Browser, origin: str, **options: Any) -> Iterator[Watch]:
    """A tab in a fresh context, watched."""
    context = browser.new_context(**options)
    try:
        yield Watch(context.new_page(), origin)
    finally:
        context.close()


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *arguments: Any) -> None:
        """Say nothing."""


@contextmanager
def served(site: Path) -> Iterator[str]:
    """Serve a folder on the loopback interface; the value is its origin."""
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=str(site))) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}/"
        finally:
            server.shutdown()
            thread.join()
