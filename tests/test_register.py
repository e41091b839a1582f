"""The register of open points: all there, switches that switch, links that lead somewhere."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest
from browser import browser_executable
from playwright.sync_api import sync_playwright
from pydantic import ValidationError

from softwave_min.identity import ROOT
from softwave_min.open_values import GAIN, GRADATION, open_values
from softwave_min.parameters import SET_NAMES, ParameterError, parameter_set
from softwave_min.register import OpenPoint, Switch, open_points

POINTS = {one.id: one for one in open_points()}
SWITCHES = [
    pytest.param(switch, id=f"{name}-{switch.field}")
    for name, one in POINTS.items()
    for switch in one.switches
]
BOOK = ROOT / "book"
NUMBER = re.compile(r"\bA\d\d\b")
SLIP = OpenPoint(
    id="A99",
    kind="slip",
    place="somewhere",
    says="Something.",
    readings=("one", "other"),
    choice=2,
    reason="Because.",
    page="conventions",
)


def notebook(name):
    return json.loads((ROOT / f"{name}.ipynb").read_text(encoding="utf-8"))


def source_of(page):
    """What the book's author wrote on a page."""
    if page.startswith("notebooks/"):
        return "\n".join("".join(cell["source"]) for cell in notebook(page)["cells"])
    return (BOOK / f"{page}.md").read_text(encoding="utf-8")


def labels_of(page):
    """What can be referred to on a page, be it made by the author or by a cell."""
    found = set(
        re.findall(
            r"^\(([\w-]+)\)=|:name: ([\w-]+)|\"(tab-[\w-]+)\"", source_of(page), re.MULTILINE
        )
    )
    names = {name for match in found for name in match if name}
    made = [cell["metadata"] for cell in notebook(page)["cells"]]
    return names | set(re.findall(r'"name": "([\w-]+)"', json.dumps(made)))


def pages_with_points():
    """Ids that each notebook mentions."""
    names = [f"notebooks/{path.stem}" for path in sorted((ROOT / "notebooks").glob("*.ipynb"))]
    return {name: set(NUMBER.findall(source_of(name))) for name in names}


def test_no_point_is_missing():
    assert list(POINTS) == [f"A{number:02d}" for number in range(1, 52)]


def test_every_point_that_a_chapter_mentions_is_registered():
    mentioned = set().union(*pages_with_points().values())
    assert mentioned
    assert mentioned <= set(POINTS)


def test_points_of_open_values_are_registered_with_a_switch_for_each():
    for value in open_values():
        fields = {switch.field for switch in POINTS[value.ambiguity].switches}
        assert (GAIN if value.field == GRADATION else value.field) in fields


@pytest.mark.parametrize("switch", SWITCHES)
@pytest.mark.parametrize("name", SET_NAMES)
def test_a_switch_changes_its_field_and_nothing_else(switch, name):
    nominal = parameter_set(name)
    section, field = switch.field.split(".")
    for value, other in zip(switch.values, switch.alternatives(nominal), strict=True):
        changed = getattr(getattr(other, section), field)
        assert changed == (tuple(value) if isinstance(value, list) else value)
        assert changed != getattr(getattr(nominal, section), field)
        part = replace(
            getattr(other, section), **{field: getattr(nominal, section).__dict__[field]}
        )
        assert replace(other, **{section: part}) == nominal


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        ("fluid.morrison", "textbook", "unknown field"),
        ("water.morison", "textbook", "unknown field"),
        ("fluid.morison", "manual", "'paper' or 'textbook'"),
        ("nmpc.horizon", 0, ">= 1"),
        ("arm.density", [1050.0], "as many entries as segments"),
        ("preview.redrawn", 1.0, "already"),
        ("fluid.morison", "paper", "already"),
    ],
)
def test_a_switch_that_selects_nothing_is_refused(field, value, complaint):
    with pytest.raises(ParameterError, match=complaint):
        Switch(field=field, values=(value,)).alternatives(parameter_set())


def test_a_switch_that_the_nominal_set_has_already_is_refused_with_its_point():
    nominal = parameter_set()
    textbook = replace(nominal, fluid=replace(nominal.fluid, morison="textbook"))
    with pytest.raises(ParameterError, match=r"A03: switch: fluid\.morison"):
        open_points(textbook)


@pytest.mark.parametrize("wrong", [{"choice": 3}, {"choice": 0}, {"readings": ("one",)}])
def test_a_point_takes_one_of_at_least_two_readings(wrong):
    with pytest.raises(ValidationError):
        replace(SLIP, **wrong)


@pytest.mark.parametrize("point", POINTS.values(), ids=POINTS)
def test_a_point_leads_to_where_it_is_treated(point):
    names = {page for page, ids in pages_with_points().items() if point.id in ids}
    assert source_of(point.page)
    assert point.page in names or not names
    if point.label:
        assert point.label in labels_of(point.page)


@pytest.mark.parametrize("point", POINTS.values(), ids=POINTS)
def test_files_that_a_point_names_are_there(point):
    for path in re.findall(r"\b(?:data|results)/[\w/]+\.\w+", point.elsewhere):
        assert (ROOT / path).is_file()


# --- the page ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A book of that page alone; what its builder said."""
    folder = tmp_path_factory.mktemp("project")
    source = folder / "book"
    source.mkdir()
    shutil.copytree(ROOT / "data" / "paper", folder / "data" / "paper")
    shutil.copyfile(BOOK / "register.md", source / "index.md")
    (source / "conf.py").write_text(
        f"import sys\nsys.path.insert(0, {str(BOOK / '_ext')!r})\n"
        "extensions = ['myst_parser', 'register']\nnumfig = True\n"
        f"html_static_path = [{str(BOOK / '_static')!r}]\nhtml_js_files = ['claims.js']\n"
    )
    command = [sys.executable, "-m", "sphinx", "-q", source, folder / "site"]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    return folder / "site" / "index.html", answer.stderr


@pytest.fixture(scope="module")
def page(site):
    """The text of the page; what its builder said."""
    return site[0].read_text(encoding="utf-8"), site[1]


def test_the_page_has_every_point_with_its_readings_and_its_link(page):
    text, said = page
    assert re.findall(r'<tr [^>]*id="(a\d\d)"', text) == [name.lower() for name in POINTS]
    assert text.count('class="reading-taken"') == len(POINTS)
    for point in POINTS.values():  # the other pages are not in this book, and that is said
        assert f"/{point.page}" in said
        assert all(switch.field in text for switch in point.switches)


def test_the_snippet_of_the_page_runs():
    (snippet,) = re.findall(
        r"^```python\n(.*?)^```", source_of("register"), re.DOTALL | re.MULTILINE
    )
    reader = {"__name__": "reader"}
    exec(snippet, reader)
    assert reader["other"] != reader["nominal"]


def test_the_page_counts_the_points(page):
    counted = [int(number) for number in re.findall(r'class="quoted">(\d+)<', page[0])]
    kinds = [
        sum(one.kind == kind for one in POINTS.values())
        for kind in ("slip", "gap", "wording", "argument")
    ]
    switched = sum(bool(one.switches) for one in POINTS.values())
    assert counted == [len(POINTS), *kinds, switched]
    assert sum(kinds) == len(POINTS)


def test_the_page_does_not_promise_effects_that_are_not_measured(page):
    assert "not yet part of this table" in page[0]


def test_the_points_can_be_filtered_by_kind_and_switch(site):
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=str(browser_executable()), args=["--no-sandbox"]
        )
        tab = browser.new_page()
        tab.goto(site[0].as_uri())

        def shown():
            rows = tab.locator("table.claims tbody tr:visible td:first-child p:first-child")
            return rows.all_inner_texts()

        assert shown() == list(POINTS)
        tab.get_by_label("Every kind").select_option("argument")
        assert shown() == [name for name, one in POINTS.items() if one.kind == "argument"]
        tab.get_by_label("Every kind").select_option("")
        tab.get_by_label("Every switch").select_option("none")
        assert shown() == [name for name, one in POINTS.items() if not one.switches]
        tab.get_by_label("Search the points").fill("star previewed")
        assert shown() == ["A18"]
        browser.close()
