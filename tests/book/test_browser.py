"""A browser is found where there is one, and its absence is said in a line."""

from __future__ import annotations

import browser
import pytest


@pytest.fixture
def machine(tmp_path, monkeypatch):
    """A machine without a browser, on which none can be installed; put some on it."""
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(browser, "PLACES", ())
    monkeypatch.setattr(browser, "playwright_path", lambda: tmp_path / "absent")
    monkeypatch.setattr(browser, "from_playwright", lambda: iter(()))
    monkeypatch.setattr(browser, "from_debian", lambda: iter(()))
    browser.browser_executable.cache_clear()

    def put(name, status):
        path = tmp_path / name
        path.write_text(f"#!/bin/sh\nexit {status}\n")
        path.chmod(0o755)
        return path

    yield put
    browser.browser_executable.cache_clear()


def test_a_browser_that_does_not_start_is_passed_over(machine):
    machine("chromium", status=1)
    chrome = machine("google-chrome", status=0)
    assert browser.browser_executable() == chrome


def test_what_can_be_installed_is_tried_in_turn(machine, monkeypatch):
    package = machine("from-debian", status=0)
    monkeypatch.setattr(browser, "from_debian", lambda: iter((package,)))
    assert browser.browser_executable() == package


def test_no_browser_at_all_is_one_line(machine):
    machine("chromium", status=1)
    with pytest.raises(browser.NoBrowserError) as refusal:
        browser.browser_executable()
    assert "\n" not in str(refusal.value)
