"""Books of a page or two, built with the extensions of the real one."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from browser import browser_executable
from playwright.sync_api import Page, sync_playwright

from softwave_min.data import ROOT

BOOK = ROOT / "book"
MYST = ["attrs_inline", "colon_fence", "dollarmath"]
FILTERED = {"html_static_path": [str(BOOK / "_static")], "html_js_files": ["claims.js"]}
"""Settings of a book whose tables can be filtered."""


def bound(folder: Path, extensions: Sequence[str], **settings: Any) -> tuple[Path, str]:
    """Build ``folder/book``; the folder of its pages, and what its builder said."""
    lines = [
        f"import sys\nsys.path.insert(0, {str(BOOK / '_ext')!r})",
        f"extensions = {list(extensions)!r}\nnumfig = True",
        f"myst_enable_extensions = {MYST!r}",
        *(f"{name} = {value!r}" for name, value in settings.items()),
    ]
    (folder / "book" / "conf.py").write_text("\n".join(lines) + "\n")
    command = [sys.executable, "-m", "sphinx", "-q", folder / "book", folder / "site"]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    return folder / "site", answer.stderr


@contextmanager
def opened(page: Path) -> Iterator[Page]:
    """A page in a browser."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=str(browser_executable()), args=["--no-sandbox"]
        )
        tab = browser.new_page()
        tab.goto(page.as_uri())
        yield tab
        browser.close()


def shown(tab: Page, column: int = 1) -> list[str]:
    """First lines of the visible cells of a column, of the table that can be filtered."""
    cells = f"table.claims tbody tr:visible td:nth-child({column}) p:first-child"
    return tab.locator(cells).all_inner_texts()
