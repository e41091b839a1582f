"""Books of a page or two, built with the extensions of the real one."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

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
