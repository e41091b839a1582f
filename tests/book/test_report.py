"""The reproducibility report: computed, whole, and another one when the tables are others."""

from __future__ import annotations

import json
import re
import shutil

import pandas as pd
import pytest
import small_book
from book_pages import Page, words

from softwave_min.data import ROOT
from softwave_min.paper.claims import claims
from softwave_min.paper.open_points import open_points
from softwave_min.paper.verdicts import FAILED
from softwave_min.runs.store import results_folder
from softwave_min.studies.ranges import plausible_ranges

BOOK = ROOT / "book"
ROWS = pd.read_csv(results_folder() / "claims" / "claims.csv", keep_default_na=False)
SHARED = {"C38", "C39"}
"""Two claims with one reason."""
GAPS = {one.id for one in open_points() if one.kind == "gap"}
ASKED = GAPS | {one.open_point for one in plausible_ranges()}
EFFECTS = {"A26": 2.0, "A34": 9.0, "A25": 4.0, "A14": 0.5}
PROVENANCE = {
    "experiment": "star",
    "title": "The star",
    "runs": {
        "a": {"seconds": 200.0, "solver_statuses": {"CONVERGED": 600}},
        "b": {"seconds": 100.0, "solver_statuses": {"CONVERGED": 598, "ITERATION_LIMIT": 2}},
    },
    "machine": {"python": "3.1.4", "platform": "Abacus", "processors": 7, "libraries": {"np": "9"}},
    "engine": "by hand",
    "commit": "abcdef0123456789",
}


def judged(failing, verdict, why):
    """A table of verdicts in which these claims fail, and all else of the kind holds."""
    good = {"number": "reproduced", "explanation": "supported", "artefact": "regenerated"}
    table = ROWS.assign(why="", verdict=ROWS["kind"].map(good).fillna("reproduced"))
    table.loc[table["id"].isin(failing), ["verdict", "why"]] = verdict, why
    return table


def built(folder, table, effects=None):
    """A book of report, claims and open points; its report, and what its builder said."""
    source = folder / "book"
    results = source / "results"
    (results / "claims").mkdir(parents=True)
    for name in ("report.md", "claims.md", "open_points.md", "references.bib"):
        shutil.copyfile(BOOK / name, source / name)
    (source / "index.md").write_text("# Book\n\n```{toctree}\nreport\nclaims\nopen_points\n```\n")
    shutil.copytree(results_folder() / "random_seas", results / "random_seas")
    (results / "random_seas" / "provenance.json").write_text("{}")
    (results / "star").mkdir()
    (results / "star" / "provenance.json").write_text(json.dumps(PROVENANCE))
    table.to_csv(results / "claims" / "claims.csv", index=False)
    if effects is not None:
        (results / "open_points").mkdir()
        effects.to_csv(results / "open_points" / "points.csv", index=False)
    own = ["quoted", "drawing", "report", "claims", "open_points"]
    pages, said = small_book.bound(
        folder,
        ["sphinxcontrib.bibtex", "myst_parser", *own],
        html_theme="sphinx_book_theme",
        bibtex_bibfiles=["references.bib"],
    )
    return Page(pages, pages / "report.html"), said


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    table = judged(SHARED, "not reproduced", "Because of 1.25 m.")
    return built(tmp_path_factory.mktemp("report"), table)


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """The report with the effects of the open points, and another claim that fails."""
    columns = ("largest_reduction", "lowest_reduction", "rise", "star")
    endings = ("", "_times", "_at", "_exceeds")
    same = {f"{one}{ending}": 1.0 for one in columns for ending in endings}
    same |= {"field": "a.b", "status": "measured", "matters": "yes", "exceeds": "yes"}
    rows = [{"point": name, "times": times} | same for name, times in EFFECTS.items()]
    table = judged({"C59"}, FAILED[0], "Oh.")
    return built(tmp_path_factory.mktemp("measured"), table, pd.DataFrame(rows))


def section(page, title):
    """The section under a heading."""
    (found,) = (
        one for one in page.content.find_all("section") if title in words(one.find(["h1", "h2"]))
    )
    return found


def ids(element, letter):
    """What a part of the page has links to, claims (c) or points (a), in its order."""
    targets = (link["href"] for link in element.select("a[href]"))
    found = (re.search(rf"#\w+-({letter}\d\d)$", target) for target in targets)
    return list(dict.fromkeys(one[1].upper() for one in found if one))


def test_no_part_of_the_report_is_missing(report):
    page, said = report
    assert "report: " not in said
    titles = [heading.text for heading in page.content.find_all("h2")]
    for part in (
        "original article", "attempted", "assumed", "Methods", "agrees", "does not agree",
        "How firm", "would take", "Environment", "Limits",
    ):  # fmt: skip
        assert any(part in title for title in titles), part


def test_every_claim_that_is_no_artefact_is_on_one_side(report):
    holds = ids(section(report[0], "What agrees"), "c")
    fails = ids(section(report[0], "What does not agree"), "c")
    numbers = [one.id for one in claims() if one.kind == "number"]
    others = {one.id for one in claims() if one.kind in {"trend", "explanation"}}
    assert holds[: len(numbers)] == numbers  # the table has all of them, the list those that hold
    assert set(holds) == {*numbers, *others}
    assert set(fails) == SHARED


def test_claims_that_fail_for_one_reason_share_it(report):
    text = words(section(report[0], "What does not agree"))
    assert text.count("Because of 1.25 m.") == 1


def test_the_report_counts_the_claims(report):
    said = report[0].path.read_text(encoding="utf-8")
    assert f'"quoted">{len(SHARED)}</span> claims are not reproduced' in said
    table = section(report[0], "Summary").table
    *_, last = table.find_all("tr")
    counted = [int(cell.text) for cell in last.find_all("td")[1:]]
    assert sum(counted) == len(claims())


def test_another_table_is_another_report(measured):
    page, said = measured
    # it has no reason in the project's data, and that is said
    assert "C59 is not reproduced, without a reason" in said
    assert "report: " in said
    assert "C59" not in ids(section(page, "What agrees"), "c")


def test_what_is_wanted_is_all_that_is_missing_in_the_order_of_its_effect(report, measured):
    without = ids(section(report[0], "What it would take"), "a")
    assert without == sorted(ASKED)
    found = ids(section(measured[0], "What it would take"), "a")
    assert sorted(found) == sorted(ASKED)
    known = sorted(EFFECTS.keys() & ASKED, key=lambda name: -EFFECTS[name])
    assert found[: len(known)] == known


def test_what_is_wanted_has_the_plausible_ranges(report):
    text = words(section(report[0], "What it would take"))
    for one in plausible_ranges():
        assert f"{one.low:.4g} to {one.high:.4g}" in text


def test_the_points_that_matter_most_are_named_if_they_were_measured(report, measured):
    assert "not among the results" in words(section(report[0], "What was assumed"))
    found = ids(section(measured[0], "What was assumed"), "a")
    assert found == sorted(EFFECTS, key=lambda name: -EFFECTS[name])
    assert "9.0 \N{MULTIPLICATION SIGN}" in words(section(measured[0], "What was assumed"))


def test_what_was_run_is_counted_and_can_be_linked_to(report):
    text = words(section(report[0], "What was attempted"))
    assert "5 min" in text
    assert "2 of 1200" in text
    assert "experiment-star" in report[0].anchors
    claims_page = (report[0].site / "claims.html").read_text()
    assert 'href="report.html#experiment-star"' in claims_page


def test_the_environment_is_that_of_the_results(report):
    text = words(section(report[0], "Environment"))
    for part in ("3.1.4", "Abacus, 7 processors", "by hand", "abcdef012345"):
        assert part in text
