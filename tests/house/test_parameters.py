"""Parameter sets, and the note of every file in ``data/`` that is read."""

from __future__ import annotations

import os
import shutil
import tomllib

import pytest

from softwave_min.data import READ_LOG, ParameterError, data_folder, recording
from softwave_min.parameters import (
    SET_NAMES,
    ParameterSet,
    load_data,
    load_parameters,
    validate,
)
from softwave_min.waves.records import read_spectrum

FOLDER = data_folder() / "parameters"
VALUES = tomllib.loads((FOLDER / "physical.toml").read_text())
FLAGS = [
    (section, name)
    for section, fields in VALUES.items()
    for name, value in fields.items()
    if isinstance(value, bool)
]
BUOY = "buoys/41010w2019part.txt.gz"


@pytest.mark.parametrize(("section", "name"), FLAGS)
@pytest.mark.parametrize("value", ["yes", 1, "true"])
def test_what_is_true_or_false_is_nothing_else(section, name, value):
    values = {**VALUES, section: {**VALUES[section], name: value}}
    with pytest.raises(ParameterError, match=f"{section}.{name} = {value!r}: must be true or fal"):
        validate(ParameterSet, values, source="mine.toml")


def test_there_are_flags_to_be_strict_about():
    names = {name for _, name in FLAGS}
    assert names >= {"rotary_inertia", "real_time", "redrawn", "waves", "known"}


@pytest.mark.parametrize("name", SET_NAMES)
def test_a_set_is_loaded_by_name_by_path_or_by_path_as_text(name, tmp_path):
    path = shutil.copy(FOLDER / f"{name}.toml", tmp_path / "mine.toml")
    assert load_parameters(name) == load_parameters(path) == load_parameters(str(path))


def test_a_name_of_no_set_is_refused_with_those_there_are():
    with pytest.raises(ParameterError, match="'nominal'; there are: calibrated, physical"):
        load_parameters("nominal")


def test_every_read_within_a_recording_is_in_it(tmp_path, monkeypatch):
    log = tmp_path / "log"
    path = data_folder() / BUOY
    with recording() as outer:
        load_parameters("physical")
        with recording() as inner:
            monkeypatch.setenv(READ_LOG, os.fspath(log))
            with pytest.raises(ParameterError, match="name a time"):
                read_spectrum(str(path))
    load_parameters("calibrated")
    assert inner == {path}
    assert outer == {path, FOLDER / "physical.toml"}
    assert set(log.read_text().splitlines()) == {str(path), str(FOLDER / "calibrated.toml")}


def test_data_that_were_loaded_before_are_noted_and_loaded_anew_when_changed(tmp_path, monkeypatch):
    monkeypatch.setattr("softwave_min.parameters.data_folder", lambda: tmp_path)
    path = tmp_path / "numbers.toml"
    for moment, value in enumerate((1.0, 1.0, 2.0)):
        path.write_text(f"a = {value}\n")
        os.utime(path, (moment, moment))
        with recording() as found:
            assert load_data(dict[str, float], "numbers.toml") == {"a": value}
        assert found == {path}
