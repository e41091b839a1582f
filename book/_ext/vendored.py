"""Copies ``book/vendor`` into the pages' ``_static``.

The folder stands apart from ``book/_static`` because Jupyter Book adds every script
that it finds there to every page.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.config import Config


def add_vendor_folder(app: Sphinx, config: Config) -> None:
    """Make ``vendor`` a folder of static files."""
    config.html_static_path.append(str(Path(app.srcdir) / "vendor"))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect("config-inited", add_vendor_folder)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
