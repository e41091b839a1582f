"""The built book: whole, readable from disk with no network, and made of what is there now."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import json
import re
import shutil
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import small_book
import yaml
from book_browser import served, tab
from book_pages import Page, pages, problems, words
from browser import browser_executable
from playwright.sync_api import Browser, sync_playwright

from softwave_min.data import ROOT

BOOK = ROOT / "book"
SITE = BOOK / "_build" / "html"
NOTATION = tomllib.loads((ROOT / "data" / "notation.toml").read_text(encoding="utf-8"))
SYMBOLS = [symbol for group in NOTATION.values() for symbol in group]


def load(path: Path) -> ModuleType:
    """Import a module that is in no package."""
    specification = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


sys.path.insert(0, str(BOOK / "_ext"))
builder, drawing, quoted = (
    load(BOOK / name) for name in ("build.py", "_ext/drawing.py", "_ext/quoted.py")
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    executable = str(browser_executable())
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture(params=["disk", "server"])
def origin(request: pytest.FixtureRequest) -> Iterator[str]:
    """Where a reader may have the book from."""
    if request.param == "disk":
        yield f"{SITE.as_uri()}/"
    else:
        with served(SITE) as address:
            yield address


def content(name: str) -> Page:
    return Page(SITE, SITE / name)


# The book itself


def test_the_book_is_made_of_what_is_there_now() -> None:
    assert builder.is_current(), "stale or missing: run 'make book'"


def test_every_file_of_the_contents_became_a_page() -> None:
    contents = (BOOK / "_toc.yml").read_text(encoding="utf-8")
    named = re.findall(r"(?:file|root): (\S+)", contents)
    assert len(named) > 5
    assert {f"{name}.html" for name in named} <= {page.name for page in pages(SITE)}


def test_pages_are_whole() -> None:
    assert problems(SITE) == []


def test_pages_work_in_a_browser_without_a_network(browser: Browser, origin: str) -> None:
    with tab(browser, origin) as watch:
        faults = [
            fault for page in pages(SITE) for fault in watch.open(page.name, len(page.formulas))
        ]
    assert faults == []


def test_there_are_formulas_to_typeset() -> None:
    for chapter in ("waves", "kinematics", "dynamics", "morison", "baseline", "nmpc"):
        assert content(f"notebooks/{chapter}.html").formulas


def test_the_search_works(browser: Browser, origin: str) -> None:
    with tab(browser, origin) as watch:
        assert watch.open("search.html?q=stiffness", 0) == []
        watch.tab.wait_for_selector("#search-results li a")
        found = watch.tab.locator("#search-results li a").all_inner_texts()
        assert any("Notation" in title for title in found)
        assert watch.faults == []


@pytest.mark.parametrize(("motion", "paused"), [("no-preference", False), ("reduce", True)])
def test_the_film_plays_unless_the_reader_wants_less_motion(
    browser: Browser, motion: str, paused: bool
) -> None:
    with tab(browser, f"{SITE.as_uri()}/", reduced_motion=motion) as watch:
        assert watch.open("index.html", len(content("index.html").formulas)) == []
        film = watch.tab.locator("article figure video")
        assert film.count() == 1
        assert film.evaluate("one => [one.muted, one.loop, one.controls]") == [True, True, True]
        assert film.evaluate("one => one.paused") is paused


def test_the_film_has_both_formats_a_poster_and_the_words_that_the_code_wrote() -> None:
    said = drawing.described(ROOT / "results" / "example_case" / "headline")
    (film,) = content("index.html").content.find_all("video")
    assert film["aria-label"] == said["alt"]
    assert said["caption"] in words(film.parent)
    sources = [source["src"] for source in film.find_all("source")]
    assert [Path(source).suffix for source in sources] == [".webm", ".mp4"]
    assert film["poster"].endswith(".svg")
    for name in (*sources, film["poster"]):
        original = ROOT / "results" / "example_case" / Path(name).name
        assert (SITE / name).read_bytes() == original.read_bytes()


def test_the_title_page_quotes_the_table() -> None:
    table = ROOT / "results" / "example_case" / "example_case.csv"
    text = words(content("index.html").content)
    for sea in ("jonswap", "measured"):
        for controller in ("baseline", "nmpc"):
            cell = quoted.cell(table, f"{sea}/{controller}", "rmse")
            assert f"{float(cell):.3f}" in text


# Notation


@pytest.mark.parametrize(
    "symbol", [one for one in SYMBOLS if "code" in one], ids=lambda one: one["code"]
)
def test_names_in_the_notation_are_in_the_package(symbol: dict[str, str]) -> None:
    assert has_name(resolve(symbol["where"]), symbol["code"])


def test_names_that_are_not_in_the_package_are_noticed() -> None:
    place = resolve("parameters.ArmParameters")
    assert not has_name(place, "no_such_name")
    assert not has_name(resolve("waves.Sea.velocity"), "no_such_argument")
    with pytest.raises(ModuleNotFoundError):
        resolve("no_such_module")


def test_every_symbol_is_on_the_page_of_notation() -> None:
    shown = {formula.text for formula in content("notation.html").formulas}
    assert {rf"\({one['symbol']}\)" for one in SYMBOLS} <= shown


def resolve(place: str) -> Any:
    """Module, class or function below the package."""
    found: Any = importlib.import_module("softwave_min")
    for part in place.split("."):
        if isinstance(found, ModuleType) and not hasattr(found, part):
            found = importlib.import_module(f"{found.__name__}.{part}")
        else:
            found = getattr(found, part)
    return found


def has_name(place: Any, name: str) -> bool:
    """Whether it is an attribute, a field or an argument there."""
    if is_dataclass(place) and name in {field.name for field in fields(place)}:
        return True
    if inspect.isfunction(place) or inspect.ismethod(place):
        return name in inspect.signature(place).parameters
    return hasattr(place, name)


# What the book tells the reader to type


def test_the_snippets_run(capsys: pytest.CaptureFixture[str]) -> None:
    text = (BOOK / "bring_your_own.md").read_text(encoding="utf-8")
    snippets = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert len(snippets) > 5
    exec("\n".join(snippets), {"__name__": "reader"})
    errors = re.findall(r"(\d\.\d+) m$", capsys.readouterr().out, re.MULTILINE)
    assert len(errors) == 2
    assert all(0 < float(error) < 2 for error in errors)


# Numbers that are quoted


def test_a_cell_is_found_by_its_leading_columns(tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    table.write_text("sea,arm,rmse\nW1,a,0.5\nW1,b,-0.25\nW2,a,1.5\n", encoding="utf-8")
    assert quoted.cell(table, "W1/b", "rmse") == "-0.25"
    assert quoted.cell(table, "W2", "arm") == "a"
    for row, column in (("W1", "rmse"), ("W3", "rmse"), ("W2", "none")):
        with pytest.raises(LookupError):
            quoted.cell(table, row, column)


def test_a_quantity_is_formatted() -> None:
    assert quoted.formatted("-0.256", ".2f") == "\N{MINUS SIGN}0.26"
    assert quoted.formatted("W1", "") == "W1"


QUOTING = """# Page

Good: {value}`t.csv:row:a:`, {parameter}`paper/poses.toml:P1.0:.1f`.

```{quoted-table} k.csv
:caption: All.
:where: kind=a
kind | of |
ms | ms | .1f
```

```{quoted-table} m.json
```
"""
MISQUOTED = {
    "{value}`none.csv:row:a:`": "none.csv",
    "{value}`t.csv:row:b:`": "t.csv:row:b",
    "{value}`t.csv:row:a:.1f`": "text",
    "{value}`t.csv`": "'t.csv'",
    "{parameter}`paper/poses.toml:P1.2:`": "P1.2",
    "{parameter}`paper/poses.toml:none:`": "'paper/poses.toml:none:'",
    "```{drawing} none/a\n```": "'a' of none",
    "```{drawing} e/none\n```": "'none' of e",
    "```{drawing} e/a\n```": "e/a.svg",
    "```{notation} none\n```": "'none'",
    "```{report} gossip\n```": "gossip",
    "```{quoted-table} absent.csv\nkind | of |\n```": "absent.csv",
    "```{quoted-table} k.csv\nabsent | of |\n```": "no column 'absent'",
    "```{quoted-table} k.csv\n:where: kind=c\nkind | of |\n```": "kind=c",
    "```{quoted-table} k.csv\nkind | of | .1f\n```": "'a'",
}


def test_what_can_be_quoted_is_shown_and_what_cannot_is_a_warning(tmp_path: Path) -> None:
    assert "-W" in builder.BUILD  # to the builder every warning is an error
    page = QUOTING + "".join(f"\n{one}\n" for one in MISQUOTED)
    for name, text in {
        "book/index.md": page,
        "book/results/t.csv": "key,a\nrow,text\n",
        "book/results/e/provenance.json": '{"figures": {"a": {"caption": "A.", "alt": "A."}}}',
        "k.csv": "kind,ms\na,-1.234\nb,5.678\na,\n",
        "m.json": '{"cores": 2, "clean": true}',
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    extensions = ["myst_parser", "quoted", "drawing", "notation", "report"]
    site, said = small_book.bound(tmp_path, extensions)
    complaints = [line for line in said.splitlines() if "WARNING" in line]
    assert len(complaints) == len(MISQUOTED), said
    for word in MISQUOTED.values():
        assert any(word in complaint for complaint in complaints), word
    shown = words(Page(site, site / "index.html").root.body)
    for quoted_text in ("text , 0.3 .", "\N{MINUS SIGN}1.2", "\N{EN DASH}", "cores 2 clean yes"):
        assert quoted_text in shown, shown
    assert "5.7" not in shown


# When the book is built


INGREDIENTS = ("book/index.md", "notebooks/a.ipynb", "results/e/t.csv", "results/e/f.svg")
INGREDIENTS += ("data/p.toml", "environment.lock")
MADE = ("results/e/runs/r.npz", "book/_build/html/index.html")


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with one file of each kind, that the builder takes for its own."""
    for name in (*INGREDIENTS, *MADE):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("before", encoding="utf-8")
    monkeypatch.setattr(builder, "ROOT", tmp_path)
    monkeypatch.setattr(builder, "BOOK", tmp_path / "book")
    monkeypatch.setattr(builder, "PAGES", tmp_path / "book" / "_build" / "html")
    monkeypatch.setattr(builder, "STAMP", tmp_path / "stamp")
    (tmp_path / "stamp").write_text(json.dumps(builder.identity().parts), encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("name", [*INGREDIENTS, "book/new.md", *MADE])
def test_a_change_of_an_ingredient_makes_the_book_stale(project: Path, name: str) -> None:
    assert builder.is_current()
    (project / name).write_text("after", encoding="utf-8")
    assert builder.is_current() is (name in MADE)


def test_a_book_that_did_not_build_is_stale(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (project / "book" / "index.md").write_text("after", encoding="utf-8")
    monkeypatch.setattr(builder, "BUILD", ("build", str(project / "nowhere")))
    assert builder.main() == 1
    assert "nowhere" in capsys.readouterr().out
    assert not builder.is_current()


# The checks notice what they are for

GOOD = (
    '<article><h1 id="top">T</h1><a href="#top">x</a><figure><img src="p.svg" alt="A square">'
    "<figcaption>A square</figcaption></figure></article>"
)
PICTURE = '<svg xmlns="http://www.w3.org/2000/svg" width="4" height="4"><path d="M0 0H4V4Z"/></svg>'


def site_of(folder: Path, body: str, head: str = "") -> Path:
    """A site of one page."""
    (folder / "p.svg").write_text(PICTURE, encoding="utf-8")
    (folder / "index.html").write_text(
        f'<!doctype html><html lang="en"><head><title>T</title>{head}</head>'
        f"<body>{body}</body></html>",
        encoding="utf-8",
    )
    return folder


def test_a_good_page_has_no_problems(tmp_path: Path, browser: Browser) -> None:
    site = site_of(tmp_path, GOOD)
    assert problems(site) == []
    with tab(browser, f"{site.as_uri()}/") as watch:
        assert watch.open("index.html", 0) == []


@pytest.mark.parametrize(
    ("body", "complaint"),
    [
        (GOOD + '<a href="nowhere.html">x</a>', "broken link nowhere.html"),
        (GOOD + '<a href="#nowhere">x</a>', "no anchor for link #nowhere"),
        (GOOD + '<a href="index.html#nowhere">x</a>', "no anchor for link index.html#nowhere"),
        (GOOD + '<script src="https://example.org/a.js"></script>', "script from elsewhere"),
        (GOOD + '<link rel="stylesheet" href="//example.org/a.css">', "link from elsewhere"),
        (GOOD + '<img src="none.svg" alt="x">', "img without its file none.svg"),
        (GOOD.replace(' alt="A square"', ""), "no alt text"),
        (GOOD.replace("figcaption>A square<", "figcaption><"), "no caption on figure"),
        (GOOD.replace("figure>", "div>"), "no figure around p.svg"),
        (GOOD.replace("<h1", "<h2"), "0 headings of the first level"),
        (GOOD.replace("</article>", "<h1>U</h1></article>"), "2 headings of the first level"),
        (GOOD.replace("<h1", '<video src="p.svg"></video><h1'), "no label on a film"),
    ],
)
def test_a_faulty_page_is_noticed(tmp_path: Path, body: str, complaint: str) -> None:
    assert any(complaint in problem for problem in problems(site_of(tmp_path, body)))


def test_a_page_without_language_or_title_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "index.html").write_text(f"<html>{GOOD}</html>", encoding="utf-8")
    found = " ".join(problems(tmp_path))
    assert "no language" in found
    assert "no title" in found


def test_what_a_browser_meets_is_noticed(tmp_path: Path, browser: Browser) -> None:
    configuration = yaml.safe_load((BOOK / "_config.yml").read_text(encoding="utf-8"))
    mathjax = configuration["sphinx"]["config"]["mathjax3_config"]
    shutil.copy(BOOK / "vendor" / "mathjax" / "tex-svg.js", tmp_path)
    site = site_of(
        tmp_path,
        '<article><img src="none.svg"><video src="none.webm"></video>'
        '<p style="width: 600px">wide</p><p class="math">\\(\\nosuch\\)</p></article>'
        "<script>console.error('planted'); setTimeout(() => nothing.there);"
        "fetch('http://127.0.0.1:8/').catch(() => {});</script>",
        head=f"<script>MathJax = {json.dumps(mathjax)}</script>"
        '<script defer src="tex-svg.js"></script>',
    )
    with tab(browser, f"{site.as_uri()}/") as watch:
        found = "\n".join(watch.open("index.html", 2))
    for complaint in (
        "console error: planted",
        "nothing is not defined",
        "request to elsewhere: http://127.0.0.1:8/",
        "failed request: ",
        "formula: Undefined control sequence \\nosuch",
        "1 of 2 formulas",
        "picture without pixels: none.svg",
        "film does not load",
        "wider than 390 px",
    ):
        assert complaint in found
    assert "wider than 1280 px" not in found
