"""What is wrong with built HTML pages, found by reading them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

VOID = {"area", "base", "br", "col", "embed", "hr", "img", "input", "link", "meta", "source", "wbr"}
HEADINGS = {"h1", "h2", "h3", "h4", "h5", "h6"}
LOADED = {
    "script": ("src",),
    "link": ("href",),
    "img": ("src",),
    "iframe": ("src",),
    "source": ("src",),
    "video": ("src", "poster"),
    "audio": ("src",),
    "object": ("data",),
}
"""Attributes that make a browser load something by itself."""


@dataclass
class Element:
    """An element: its name, attributes, children and text."""

    name: str
    attributes: dict[str, str]
    parent: Element | None = field(default=None, repr=False)
    children: list[Element] = field(default_factory=list, repr=False)
    words: list[str] = field(default_factory=list, repr=False)

    def all(self, *names: str) -> list[Element]:
        """All elements of these names below this one, in order."""
        found = []
        for child in self.children:
            found.extend([child] if child.name in names else [])
            found.extend(child.all(*names))
        return found

    @property
    def text(self) -> str:
        """Text of the element and of all below it."""
        return " ".join([*self.words, *(child.text for child in self.children)]).strip()

    def within(self, *names: str) -> bool:
        """Whether an element of these names is around this one."""
        return self.parent is not None and (self.parent.name in names or self.parent.within(*names))


class Tree(HTMLParser):
    """Builds the tree of elements of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.root = self._open = Element("", {})
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = {name: value or "" for name, value in attrs}
        element = Element(tag, attributes, self._open)
        self._open.children.append(element)
        if tag not in VOID:
            self._open = element

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self._open = self._open.parent

    def handle_endtag(self, tag: str) -> None:
        element = self._open
        while element is not None and element.name != tag:
            element = element.parent
        if element is not None and element.parent is not None:
            self._open = element.parent

    def handle_data(self, data: str) -> None:
        if data.strip():
            self._open.words.append(data.strip())


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
    def root(self) -> Element:
        """The page's tree."""
        return Tree(self.path.read_text(encoding="utf-8")).root

    @cached_property
    def anchors(self) -> set[str]:
        """What a link into this page can aim at."""
        return {e.attributes["id"] for e in _everything(self.root) if "id" in e.attributes}

    @cached_property
    def content(self) -> Element:
        """The article, without the theme around it."""
        articles = self.root.all("article")
        return articles[0] if articles else Element("article", {})

    @property
    def formulas(self) -> list[Element]:
        """What MathJax has to typeset."""
        marked = _everything(self.content)
        return [e for e in marked if "math" in e.attributes.get("class", "").split()]


def pages(site: Path) -> list[Page]:
    """All pages of a site that the theme does not bring along."""
    found = sorted(site.rglob("*.html"))
    return [Page(site, path) for path in found if "_static" not in path.relative_to(site).parts]


def problems(site: Path) -> list[str]:
    """Every fault of every page, one line each."""
    found = []
    by_path = {page.path.resolve(): page for page in pages(site)}
    for page in by_path.values():
        faults = [
            *_frame_faults(page),
            *_link_faults(page, by_path),
            *_load_faults(page),
            *_figure_faults(page),
        ]
        found.extend(f"{page.name}: {fault}" for fault in faults)
    return found


def _everything(element: Element) -> list[Element]:
    return [e for child in element.children for e in (child, *_everything(child))]


def _frame_faults(page: Page) -> list[str]:
    html = page.root.all("html")
    titles = [title for title in page.root.all("title") if not title.within("svg")]
    headings = page.content.all("h1")
    faults = []
    if not html or not html[0].attributes.get("lang"):
        faults.append("no language")
    if len(titles) != 1 or not titles[0].text:
        faults.append("no title")
    if page.name != "search.html" and len(headings) != 1:
        faults.append(f"{len(headings)} headings of the first level")
    return faults


def _link_faults(page: Page, by_path: dict[Path, Page]) -> list[str]:
    faults = []
    for link in page.root.all("a"):
        address = link.attributes.get("href", "")
        parts = urlsplit(address)
        if parts.scheme or parts.netloc or not address:
            continue
        target = _file(page, parts.path)
        if not target.is_file():
            faults.append(f"broken link {address}")
        elif target in by_path and unquote(parts.fragment) not in by_path[target].anchors | {""}:
            faults.append(f"no anchor for link {address}")
    return faults


def _load_faults(page: Page) -> list[str]:
    faults = []
    for element in page.root.all(*LOADED):
        for name in LOADED[element.name]:
            address = element.attributes.get(name, "")
            parts = urlsplit(address)
            if not address or parts.scheme == "data":
                continue
            if parts.scheme or parts.netloc:
                faults.append(f"{element.name} from elsewhere {address}")
            elif not _file(page, parts.path).is_file():
                faults.append(f"{element.name} without its file {address}")
    return faults


def _figure_faults(page: Page) -> list[str]:
    faults = []
    for image in page.root.all("img"):
        if not image.attributes.get("alt", "").strip():
            faults.append(f"no alt text: {image.attributes.get('src', 'img')}")
    for film in page.content.all("video"):
        if not film.attributes.get("aria-label", "").strip():
            faults.append("no label on a film")
    for picture in page.content.all("img", "video"):
        if not picture.within("figure"):
            faults.append(f"no figure around {picture.attributes.get('src', picture.name)}")
    for figure in page.content.all("figure"):
        if not any(caption.text for caption in figure.all("figcaption")):
            faults.append(f"no caption on figure {figure.attributes.get('id', '')}")
    return faults


def _file(page: Page, address: str) -> Path:
    """File that an address on a page stands for."""
    if not address:
        return page.path.resolve()
    target = (page.path.parent / unquote(address)).resolve()
    return target / "index.html" if target.is_dir() else target
