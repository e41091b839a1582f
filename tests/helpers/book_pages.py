"""What is wrong with built HTML pages, found by reading them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from urllib.parse import unquote, urlsplit

from bs4 import BeautifulSoup, Tag

LOADED = dict.fromkeys(("script", "img", "iframe", "source", "audio"), ("src",))
LOADED |= {"link": ("href",), "video": ("src", "poster"), "object": ("data",)}
"""Attributes that make a browser load something by itself."""


@dataclass(frozen=True)
class Page:
    """A page of a site."""

    site: Path
    path: Path

    @property
    def name(self) -> str:
        """Address within the site."""
        return self.path.relative_to(self.site).as_posix()

    @cached_property
    def root(self) -> BeautifulSoup:
        """The page's tree."""
        return BeautifulSoup(self.path.read_text(encoding="utf-8"), "html.parser")

    @cached_property
    def anchors(self) -> set[str]:
        """What a link into this page can aim at."""
        return {element["id"] for element in self.root.select("[id]")}

    @cached_property
    def content(self) -> Tag:
        """The article, without the theme around it."""
        return self.root.article or BeautifulSoup("<article/>", "html.parser").article

    @property
    def formulas(self) -> list[Tag]:
        """What MathJax has to typeset."""
        return self.content.select(".math")


def words(element: Tag) -> str:
    """Text of an element and of all below it."""
    return element.get_text(" ", strip=True)


def pages(site: Path) -> list[Page]:
    """All pages of a site that the theme does not bring along."""
    found = sorted(site.rglob("*.html"))
    return [Page(site, path) for path in found if "_static" not in path.relative_to(site).parts]


def problems(site: Path) -> list[str]:
    """Every fault of every page, one line each."""
    by_path = {page.path.resolve(): page for page in pages(site)}
    return [
        f"{page.name}: {fault}"
        for page in by_path.values()
        for fault in (
            *_frame_faults(page),
            *_link_faults(page, by_path),
            *_load_faults(page),
            *_figure_faults(page),
        )
    ]


def _frame_faults(page: Page) -> Iterator[str]:
    if not page.root.select("html[lang]"):
        yield "no language"
    titles = [title for title in page.root.find_all("title") if not title.find_parent("svg")]
    if len(titles) != 1 or not words(titles[0]):
        yield "no title"
    headings = page.content.find_all("h1")
    if page.name != "search.html" and len(headings) != 1:
        yield f"{len(headings)} headings of the first level"


def _link_faults(page: Page, by_path: dict[Path, Page]) -> Iterator[str]:
    for link in page.root.select("a[href]"):
        address = link["href"]
        parts = urlsplit(address)
        if parts.scheme or parts.netloc or not address:
            continue
        target = _file(page, parts.path)
        if not target.is_file():
            yield f"broken link {address}"
        elif target in by_path and unquote(parts.fragment) not in by_path[target].anchors | {""}:
            yield f"no anchor for link {address}"


def _load_faults(page: Page) -> Iterator[str]:
    for element in page.root.find_all(list(LOADED)):
        for address in filter(None, map(element.get, LOADED[element.name])):
            parts = urlsplit(address)
            if parts.scheme == "data":
                continue
            if parts.scheme or parts.netloc:
                yield f"{element.name} from elsewhere {address}"
            elif not _file(page, parts.path).is_file():
                yield f"{element.name} without its file {address}"


def _figure_faults(page: Page) -> Iterator[str]:
    for image in page.root.find_all("img"):
        if not image.get("alt", "").strip():
            yield f"no alt text: {image.get('src', 'img')}"
    for film in page.content.find_all("video"):
        if not film.get("aria-label", "").strip():
            yield "no label on a film"
    for picture in page.content.find_all(["img", "video"]):
        if not picture.find_parent("figure"):
            yield f"no figure around {picture.get('src', picture.name)}"
    for figure in page.content.find_all("figure"):
        if not any(map(words, figure.find_all("figcaption"))):
            yield f"no caption on figure {figure.get('id', '')}"


def _file(page: Page, address: str) -> Path:
    """File that an address on a page stands for."""
    if not address:
        return page.path.resolve()
    target = (page.path.parent / unquote(address)).resolve()
    return target / "index.html" if target.is_dir() else target
