"""Find a Chromium-like browser, or install one where that is possible.

``python tests/helpers/browser.py`` does it ahead of the tests, so that they find one at once.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
NAMES += ("microsoft-edge", "microsoft-edge-stable", "msedge")
PLACES = (
    "/snap/bin/chromium",
    *(
        f"/Applications/{name}.app/Contents/MacOS/{name}"
        for name in ("Google Chrome", "Chromium", "Microsoft Edge")
    ),
)
INSTALL_TIMEOUT = 900
"""Longest that an installation may take, in s."""


class NoBrowserError(RuntimeError):
    """There is no browser, and none could be installed."""


@cache
def browser_executable() -> Path:
    """Path of a browser that starts: the machine's, else playwright's, else Debian's package."""
    for find in (on_the_machine, from_playwright, from_debian):
        for path in find():
            if starts(path):
                return path
    raise NoBrowserError("no browser for the book's tests: install Chromium, Chrome or Edge")


def on_the_machine() -> Iterator[Path]:
    """Browsers on the PATH, in the usual places, or installed by playwright before."""
    yield from (Path(found) for name in NAMES if (found := shutil.which(name)))
    yield from map(Path, PLACES)
    yield playwright_path()


def from_playwright() -> Iterator[Path]:
    """The browser that playwright downloads."""
    if succeeds(sys.executable, "-m", "playwright", "install", "chromium"):
        yield playwright_path()


def from_debian() -> Iterator[Path]:
    """Debian's package, for one who may install it."""
    if os.geteuid() != 0 or not shutil.which("apt-get"):
        return
    install = ("apt-get", "install", "--yes", "--no-install-recommends", "chromium")
    if succeeds("apt-get", "update") and succeeds(*install):
        yield Path("/usr/bin/chromium")


def playwright_path() -> Path:
    """Where playwright's browser is, or would be."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        return Path(playwright.chromium.executable_path)


def starts(path: Path) -> bool:
    """Whether the browser is there and has all that it needs to start."""
    return path.is_file() and succeeds(str(path), "--headless", "--no-sandbox", "--version")


def succeeds(*command: str) -> bool:
    """Run a command without a word; whether it succeeded."""
    quietly = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    options = {"stdin": subprocess.DEVNULL, "capture_output": True, "env": quietly}
    try:
        answer = subprocess.run(command, check=False, timeout=INSTALL_TIMEOUT, **options)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return answer.returncode == 0


if __name__ == "__main__":
    try:
        sys.stdout.write(f"browser: {browser_executable()}\n")
    except NoBrowserError as error:
        sys.exit(str(error))
