"""The open points: all there, switches that switch, links that lead somewhere."""

from __future__ import annotations

import json
import re
import shutil
from collections import Counter
from dataclasses import replace
from operator import attrgetter

import numpy as np
import pandas as pd
import pytest
import small_book
from book_pages import words
from bs4 import BeautifulSoup
from pydantic import ValidationError
from small_book import FILTERED, opened, shown

from softwave_min.data import ROOT, ParameterError
from softwave_min.experiments.ablation_loops import varied
from softwave_min.paper.open_points import OpenPoint, Switch, open_points
from softwave_min.parameters import SET_NAMES, parameter_set
from softwave_min.runs.store import Store
from softwave_min.studies.open_points import GROUPS
from softwave_min.studies.ranges import GAIN, GRADATION, plausible_ranges

POINTS = {one.id: one for one in open_points()}
SWITCHES = [switch for one in POINTS.values() for switch in one.switches]
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


def test_every_point_that_a_chapter_mentions_is_there():
    assert set() < set().union(*pages_with_points().values()) <= set(POINTS)


def test_points_with_a_plausible_range_have_a_switch_for_each():
    for value in plausible_ranges():
        fields = {switch.field for switch in POINTS[value.open_point].switches}
        assert (GAIN if value.field == GRADATION else value.field) in fields


@pytest.mark.parametrize("switch", SWITCHES, ids=lambda switch: switch.field)
@pytest.mark.parametrize("name", SET_NAMES)
def test_a_switch_changes_its_field_and_nothing_else(switch, name):
    nominal = parameter_set(name)
    field = attrgetter(switch.field)
    for value, other in zip(switch.values, switch.alternatives(nominal), strict=True):
        assert field(other) == (tuple(value) if isinstance(value, list) else value)
        assert field(other) != field(nominal)
        usual = {name: attrgetter(name)(nominal) for name in (switch.field, *switch.along)}
        assert varied(other, tuple(usual.items())) == nominal


def test_what_changes_along_with_a_switch_is_applied_value_by_value():
    switch = Switch("nmpc.control_period", (0.05, 0.2), {"nmpc.horizon": (30, 8)})
    found = switch.alternatives(parameter_set())
    assert [(one.nmpc.control_period, one.nmpc.horizon) for one in found] == [(0.05, 30), (0.2, 8)]
    with pytest.raises(ValidationError, match="one per value"):
        replace(switch, along={"nmpc.horizon": (30,)})


def test_the_horizon_lasts_as_long_at_every_control_period():
    nominal = parameter_set().nmpc
    (switch,) = POINTS["A21"].switches
    for nmpc in (other.nmpc for other in switch.alternatives(parameter_set())):
        lasts = nmpc.horizon * nmpc.control_period
        assert abs(lasts - nominal.horizon * nominal.control_period) < nmpc.control_period


@pytest.mark.parametrize(
    ("field", "value", "complaint"),
    [
        ("fluid.morrison", "textbook", "unknown field"),
        ("water.morison", "textbook", "unknown field"),
        ("fluid.morison", "manual", "'paper' or 'textbook'"),
        ("nmpc.horizon", 0, ">= 1"),
        ("arm.density", [1050.0], "as many entries as segments"),
        ("preview.redrawn", 1.0, "true or false"),
        ("fluid.morison", "paper", "already"),
    ],
)
def test_a_switch_that_selects_nothing_is_refused(field, value, complaint):
    with pytest.raises(ParameterError, match=complaint):
        Switch(field=field, values=(value,)).alternatives(parameter_set())


def test_a_switch_that_the_nominal_set_has_already_is_refused_with_its_point():
    textbook = varied(parameter_set(), (("fluid.morison", "textbook"),))
    with pytest.raises(ParameterError, match=r"A03: switch: fluid\.morison"):
        open_points(textbook)


@pytest.mark.parametrize("wrong", [{"choice": 3}, {"choice": 0}, {"readings": ("one",)}])
def test_a_point_takes_one_of_at_least_two_readings(wrong):
    with pytest.raises(ValidationError):
        replace(SLIP, **wrong)


@pytest.mark.parametrize("point", POINTS.values(), ids=POINTS)
def test_a_point_leads_to_where_it_is_treated_and_names_files_that_are_there(point):
    names = {page for page, ids in pages_with_points().items() if point.id in ids}
    assert source_of(point.page)
    assert point.page in names or not names
    assert not point.label or point.label in labels_of(point.page)
    for path in re.findall(r"\b(?:data|results)/[\w/]+\.\w+", point.elsewhere):
        assert (ROOT / path).is_file()


# --- the page ---------------------------------------------------------------------------


EFFECTS = {
    "fluid.drag_coefficient": {"times": 2.5, "star": 0.0123, "star_times": 2.5, "star_at": "1.5"},
    "fluid.friction_coefficient": {"times": 0.8, "rise": -2.25, "rise_times": 0.8},
    "nmpc.angle_bound": {"times": 0.7, "rise": 2.0, "rise_times": 0.7},
}
"""What stands in a made-up table of effects beside zeros: a switch that matters, and two that do
not but can be told from another sea."""


def effects():
    """A made-up table of effects: all zero but those of `EFFECTS`."""
    zeros = {"times": 0.0}
    for group in GROUPS:
        zeros |= {group: 0.0, f"{group}_at": "1", f"{group}_times": 0.0}
    table = pd.DataFrame(
        {"point": name, "field": switch.field, "status": "measured"}
        | zeros
        | EFFECTS.get(switch.field, {})
        for name, point in POINTS.items()
        for switch in point.switches
    )
    told = {f"{group}_exceeds": table[group] != 0 for group in GROUPS}
    told |= {"exceeds": table["field"].isin(EFFECTS), "matters": table["times"] > 1}
    table = table.assign(**{name: np.where(one, "yes", "no") for name, one in told.items()})
    table.loc[table["field"] == "arm.density", "status"] = "cannot run: the sea is not finite"
    return table


def bound(folder, table=None):
    """A book of that page alone, with the effects if there are any; what its builder said."""
    source = folder / "book"
    source.mkdir()
    shutil.copyfile(BOOK / "open_points.md", source / "index.md")
    if table is not None:
        Store("open_points", source / "results").write_table("points", table)
    pages, said = small_book.bound(folder, ["myst_parser", "open_points", "drawing"], **FILTERED)
    return pages / "index.html", said


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The page with the made-up effects; what its builder said."""
    return bound(tmp_path_factory.mktemp("project"), effects())


@pytest.fixture(scope="module")
def page(site):
    """The text of the page; what its builder said."""
    return site[0].read_text(encoding="utf-8"), site[1]


def test_the_page_has_every_point_with_its_readings_and_its_link(page):
    text, said = page
    assert re.findall(r'id="point-(a\d\d)"', text) == [name.lower() for name in POINTS]
    assert text.count('class="reading-taken"') == len(POINTS)
    for point in POINTS.values():  # the other pages are not in this book, and that is said
        assert f"/{point.page}" in said
        assert all(switch.field in text for switch in point.switches)


def test_the_snippet_of_the_page_runs():
    (snippet,) = re.findall(
        r"^```python\n(.*?)^```", source_of("open_points"), re.DOTALL | re.MULTILINE
    )
    reader = {"__name__": "reader"}
    exec(snippet, reader)
    assert reader["other"] != reader["nominal"]


def test_the_page_counts_the_points(page):
    counted = [int(number) for number in re.findall(r'class="quoted">(\d+)<', page[0])]
    of_kind = Counter(one.kind for one in POINTS.values())
    kinds = [of_kind[kind] for kind in ("slip", "gap", "wording", "argument")]
    switched = sum(bool(one.switches) for one in POINTS.values())
    assert counted == [len(POINTS), *kinds, switched]
    assert sum(kinds) == len(POINTS)


def cells(text, point):
    """Text of the cells of a point's row."""
    row = BeautifulSoup(text, "html.parser").find(id=f"point-{point.lower()}").find_parent("tr")
    return [words(cell) for cell in row.find_all("td")]


def test_the_page_has_the_effect_of_every_switch(page):
    text, _ = page
    assert "not measured" not in text
    for name, point in POINTS.items():
        effect = cells(text, name)[5]
        for switch in point.switches:
            assert f"{switch.field.split('.')[1]}: " in effect
        assert bool(effect) == bool(point.switches)
    assert cells(text, "A11")[5] == (
        "2.50 \N{MULTIPLICATION SIGN} "
        "drag_coefficient: largest reduction (0), smallest reduction (0), rise (0), "
        "star +0.0123 m "
        "friction_coefficient: largest reduction (0), smallest reduction (0), "
        "rise \N{MINUS SIGN}2.2 points, star (0)"
    )
    assert "cannot run: the sea is not finite" in cells(text, "A33")[5]


def test_the_page_says_which_reading_matters_most_and_how_many_do_not(page):
    text = words(BeautifulSoup(page[0], "html.parser"))
    assert (
        "The reading that matters most is one of A11: fluid.drag_coefficient = 1.5 changes the "
        "error on the star by +0.0123 m, 2.50 \N{MULTIPLICATION SIGN} what is allowed for."
    ) in text
    switched = [name for name, one in POINTS.items() if one.switches]
    hidden = [name for name in switched if name not in {"A11", "A33", "A51"}]
    assert f"Of the {len(switched)} points with a switch {len(hidden) + 1} do not matter" in text
    assert f"moves it ({', '.join(hidden)}), with 1 some number does" in text
    assert "; 1 could not be run (A33)." in text


def test_sentences_follow_the_table_and_its_text_does_not_become_markup(tmp_path):
    odd = "a <b>bold</b> {ref}`word`, *this* [too](x) $x$ & `that` | _all_"
    table = effects()
    table.loc[table["field"] == "sea.depth", ["times", "rise_times", "rise"]] = 9.0, 9.0, 31.5
    table.loc[table["field"] == "arm.density", "status"] = odd
    text = bound(tmp_path, table)[0].read_text(encoding="utf-8")
    assert "one of A30: sea.depth" in text
    assert odd in cells(text, "A33")[5]


def test_a_page_without_measurements_says_so(tmp_path):
    text = bound(tmp_path)[0].read_text(encoding="utf-8")
    assert text.count("not measured") == 1 + sum(bool(one.switches) for one in POINTS.values())


def test_the_points_can_be_filtered_by_kind_and_switch(site):
    with opened(site[0]) as tab:
        assert shown(tab) == list(POINTS)
        tab.get_by_label("Every kind").select_option("argument")
        assert shown(tab) == [name for name, one in POINTS.items() if one.kind == "argument"]
        tab.get_by_label("Every kind").select_option("")
        tab.get_by_label("Every switch").select_option("none")
        assert shown(tab) == [name for name, one in POINTS.items() if not one.switches]
        tab.get_by_label("Search the points").fill("star previewed")
        assert shown(tab) == ["A18"]
