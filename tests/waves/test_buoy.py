"""Measured spectra: the NDBC reader, its complaints, and seas made of its records."""

import gzip
import math
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from itertools import pairwise

import numpy as np
import pytest

from softwave_min.data import ParameterError, data_folder
from softwave_min.runs.identity import digest
from softwave_min.waves import Sea
from softwave_min.waves.records import measured_sea, named_records, read_ndbc, read_spectrum

BUOYS = data_folder() / "buoys"
ARCHIVE = BUOYS / "41010w2019part.txt.gz"
REAL_TIME = BUOYS / "41010.data_spec"
HEADER = "#YY  MM DD hh mm  .0500  .1000  .2000"


@pytest.fixture
def spectral_file(tmp_path):
    def write(*lines):
        path = tmp_path / "buoy.txt"
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


def test_archive_file():
    records = read_ndbc(ARCHIVE)
    assert len(records) == 99
    first = records[0]
    assert first.time == datetime(2019, 2, 6, 0, 40)
    assert first.frequency_hz[:2] == (0.02, 0.0325)
    assert first.density[15] == 5.80
    assert len(first.frequency_hz) == len(first.density) == 47
    assert all(a.time < b.time for a, b in pairwise(records))


def test_real_time_file():
    records = read_ndbc(REAL_TIME)
    assert len(records) == 149
    last = records[-1]
    assert last.time == datetime(2020, 6, 8, 3, 50)
    assert last.frequency_hz[:2] == (0.033, 0.038)
    assert last.density[last.frequency_hz.index(0.180)] == 1.210
    assert all(a.time < b.time for a, b in pairwise(records))


def test_wave_height_agrees_with_the_buoys_own():
    """Station 41010 reported WVHT 1.1 m for 2020-06-08 03:40 in its summary, `41010.spec`."""
    record = read_spectrum(REAL_TIME, datetime(2020, 6, 8, 3, 50))
    assert record.spectrum.significant_height == pytest.approx(1.1, abs=0.1)


def test_named_records_are_the_nearest_to_the_papers_periods():
    every = [r for path in (ARCHIVE, REAL_TIME) for r in read_ndbc(path) if any(r.density)]
    for name, period in (("W1", 6.1), ("W2", 8.0), ("W3", 10.0)):
        nearest = min(every, key=lambda r: abs(r.spectrum.peak_period - period))
        assert named_records(BUOYS / "records.toml")[name] == nearest
        assert nearest.spectrum.peak_period == pytest.approx(period, abs=0.1)


def test_a_record_can_identify_a_run():
    records = read_ndbc(ARCHIVE)
    assert digest(records[0]) == digest(read_ndbc(ARCHIVE)[0])
    assert digest(records[0]) != digest(records[1])


def test_header_without_minutes_and_year_of_two_digits(spectral_file):
    path = spectral_file("YY MM DD hh  .0500  .1000", "96 01 02 03  1.00  2.00")
    (record,) = read_ndbc(path)
    assert record.time == datetime(1996, 1, 2, 3)
    assert record.density == (1.0, 2.0)
    (record,) = read_ndbc(spectral_file("YY MM DD hh  .0500  .1000", "100 01 02 03  1.00  2.00"))
    assert record.time.year == 100


def test_plain_and_compressed_files_are_read_alike(tmp_path, spectral_file):
    plain = spectral_file(HEADER, "2019 02 06 00 40 0.0 1.0 0.0")
    packed = tmp_path / "buoy.txt.gz"
    packed.write_bytes(gzip.compress(plain.read_bytes()))
    assert read_ndbc(plain) == read_ndbc(packed)


@pytest.mark.parametrize("missing", ["999.00", "MM"])
def test_records_with_missing_densities_are_left_out(spectral_file, missing):
    lines = f"2019 02 06 00 40 0.0 {missing} 0.0", "", "2019 02 06 01 40 0.0 1.0 0.0"
    path = spectral_file(HEADER, *lines)
    assert [record.time.hour for record in read_ndbc(path)] == [1]
    complaint = "no complete record of 2019-02-06 00:40:00; there are 1,"
    with pytest.raises(ParameterError, match=complaint):
        read_spectrum(path, datetime(2019, 2, 6, 0, 40))


def test_a_row_of_units_is_skipped(spectral_file):
    path = spectral_file(HEADER, "#yr  mo dy hr mn  m*m/Hz", GOOD)
    assert read_ndbc(path) == read_ndbc(spectral_file(HEADER, GOOD))


def test_a_file_of_one_record_needs_no_time(spectral_file):
    (record,) = read_ndbc(spectral_file(HEADER, GOOD))
    assert read_spectrum(spectral_file(HEADER, GOOD)) == record
    for lines, count in (([HEADER], 0), ([HEADER, GOOD, GOOD], 2)):
        with pytest.raises(ParameterError, match=f"{count} complete records: name a time"):
            read_spectrum(spectral_file(*lines))


def test_a_time_with_a_zone_is_understood(spectral_file):
    path = spectral_file(HEADER, GOOD, "2019 02 06 01 40 0 2 0")
    there = datetime(2019, 2, 6, 2, 40, tzinfo=timezone(timedelta(hours=1)))
    assert read_spectrum(path, there).time == datetime(2019, 2, 6, 1, 40)


def test_records_are_sorted_by_time(spectral_file):
    path = spectral_file(HEADER, "2019 02 06 01 40 0 1 0", "2019 02 06 00 40 0 2 0")
    assert [record.density[1] for record in read_ndbc(path)] == [2, 1]


GOOD = "2019 02 06 00 40 0.0 1.0 0.0"


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        ([""], ":1: not an NDBC spectral file"),
        (["frequency,density", "0.1,2"], ":1: not an NDBC spectral file"),
        (["#YY MM DD hh mm WVHT SwH", GOOD], ":1: 'WVHT' is not a number"),
        ([HEADER, GOOD, "2019 02 06 01 40 0.0 x 0.0"], ":3: 'x' is not a number"),
        ([HEADER, "2019 02 30 00 40 0 1 0"], ":2: '2019 02 30 00 40' is not a time"),
        ([HEADER, "2019 02"], ":2: '2019 02' is not a time"),
        ([HEADER, GOOD + " 1.0"], ":2: 4 densities for 3 frequencies"),
        ([HEADER, "2019 02 06 00 40 0 -1 0"], ":2: density: must be finite and not negative"),
        ([HEADER, "2019 02 06 00 40 0 nan 0"], ":2: density: must be finite and not negative"),
        (["#YY MM DD hh mm .2 .1 .3", GOOD], ":2: frequency_hz: must be ascending"),
        (
            ["#YY MM DD hh mm Sep_Freq < spec_1 (freq_1) ... >", "2019 02 06 00 40 9 1 (.1) 2"],
            ":2: 2 densities for 1 frequencies",
        ),
    ],
)
def test_malformed_files_are_named_with_their_line(spectral_file, lines, complaint):
    path = spectral_file(*lines)
    with pytest.raises(ParameterError) as caught:
        read_ndbc(path)
    message = str(caught.value)
    assert message.startswith(f"{path}{complaint}")
    assert "\n" not in message


def test_unreadable_files(tmp_path):
    with pytest.raises(ParameterError, match="no such file"):
        read_ndbc(tmp_path / "none.txt")
    for content in (b"not gzip", gzip.compress(b"x" * 1000)[:-9], b""):
        broken = tmp_path / "broken.txt.gz"
        broken.write_bytes(content)
        with pytest.raises(ParameterError, match=r"broken\.txt\.gz"):
            read_ndbc(broken)
    binary = tmp_path / "binary.txt"
    binary.write_bytes(b"\x89PNG\xff")
    with pytest.raises(ParameterError, match="not a text file"):
        read_ndbc(binary)
    with pytest.raises(ParameterError, match="cannot be read"):
        read_ndbc(tmp_path)


@pytest.mark.parametrize(
    ("entry", "complaint"),
    [
        ("time = 2019-02-06T00:40:00", "records.toml: A: file: missing; must be text"),
        ("file = 3\ntime = 2019-02-06T00:40:00", "records.toml: A: file = 3: must be text"),
        ("file = 'x'\ntime = 'noon'", "records.toml: A: time = 'noon'"),
        ("file = 'x'\ntime = 2019-02-06T00:40:00\nhour = 1", "records.toml: A: hour = 1: unknown"),
        ("file = 'x'\nfile_format = 'xls'", "A: file_format = 'xls': must be 'detect' or 'ndbc'"),
        ("file = 'x'\npeak_enhancement = 0.5", "A: peak_enhancement = 0.5: must be .* >= 1"),
        ("file = 'x'\npeak_enhancement = 11", "A: peak_enhancement = 11: must be .* <= 10"),
        ("file = 'x'\ntime = 2019-02-06T00:40:00", "x: no such file"),
    ],
)
def test_the_list_of_named_records_is_checked(tmp_path, entry, complaint):
    path = tmp_path / "records.toml"
    path.write_text(f"[A]\n{entry}\n")
    with pytest.raises(ParameterError, match=complaint):
        named_records(path)


def test_a_measured_sea_has_the_records_shape_and_the_height_asked_for(parameters):
    record = named_records(BUOYS / "records.toml")["W3"]
    sea = measured_sea(record, parameters, 9.81)
    assert 4 * math.sqrt(np.sum(sea.amplitude**2) / 2) == pytest.approx(3.0, rel=1e-12)
    frequency = sea.angular_frequency / (2 * np.pi)
    density = record.spectrum.density_at(frequency)
    ratio = sea.amplitude[density > 0] ** 2 / density[density > 0]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)
    jonswap = Sea.random(parameters, 9.81)
    np.testing.assert_array_equal(sea.phase, jonswap.phase)
    np.testing.assert_array_equal(sea.wave_number, jonswap.wave_number)


def test_a_record_without_waves_makes_no_sea(parameters, spectral_file):
    (record,) = read_ndbc(spectral_file(HEADER, "2019 02 06 00 40 0 0 0"))
    with pytest.raises(ParameterError, match="2019-02-06 00:40:00: a spectrum without waves"):
        measured_sea(record, parameters, 9.81)
    (swell,) = read_ndbc(spectral_file(HEADER, "2019 02 06 00 40 1 0 0"))
    with pytest.raises(ParameterError, match="none of the spectrum's waves"):
        measured_sea(swell, replace(parameters, lowest_frequency_hz=0.3), 9.81)
