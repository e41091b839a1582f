"""Files that a reader may bring: written from a known JONSWAP sea, read back, and refused."""

import gzip
import math
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial

import numpy as np
import pytest

from softwave_min.data import ParameterError
from softwave_min.waves import Sea, Spectrum, jonswap_density
from softwave_min.waves.records import (
    SeaState,
    measured_sea,
    named_records,
    read_datawell,
    read_spectrum,
    read_table,
    read_wavenet,
)

HEIGHT, PERIOD, GAMMA = 2.0, 8.0, 3.3
NOON = datetime(2021, 3, 5, 12, 0)
GRAVITY = 9.81


@pytest.fixture
def written(tmp_path):
    def write(name, lines, encoding="utf-8"):
        path = tmp_path / name
        path.write_bytes(("\r\n".join(lines) + "\r\n").encode(encoding))
        return path

    return write


def jonswap():
    """The frequencies of a Datawell buoy: 64 from 0.025 to 0.58 Hz, in steps of 5 and 10 mHz."""
    frequency = np.array([*range(25, 100, 5), *range(100, 581, 10)]) / 1000
    return Spectrum(frequency, jonswap_density(frequency, HEIGHT, PERIOD, GAMMA))


def datawell_lines():
    """A file ``.spt`` as the buoy writes it."""
    sea = jonswap()
    highest = sea.density.max()
    header = ["1", f"{100 * sea.significant_height:.0f}", "5.970", f"{highest:.4f}", "7.95", "7.85"]
    header += ["6", "0.03", "-0.01", "-0.01", "271.4\N{DEGREE SIGN}", "68.9\N{DEGREE SIGN}"]
    rows = [
        f"{f:.3f},{s / highest:.6f},{210.5:6.1f},{31.2:5.1f},-0.41, 2.85"
        for f, s in zip(sea.frequency_hz, sea.density, strict=True)
    ]
    return header + rows


def table_lines():
    sea = jonswap()
    rows = zip(sea.frequency_hz, sea.density, strict=True)
    return ["f_hz, S_m2_per_hz", *(f"{f:.3f}, {s:.6f}" for f, s in rows)]


COLUMNS = (
    "Time (GMT)",
    "Average (zero crossing) wave period (s)",
    "Dominant (peak) wave period (s)",
    "Significant wave height (Hm0) (m)",
)
PEAK, TALL = map(repr, COLUMNS[2:])


def wavenet_lines(rows=(("05/03/2021 12:00", "5.97", "8.0", "2.00"),), columns=COLUMNS):
    """A bulk export, with the tabs at the end of its lines."""
    return ["\t".join((*line, "", "")) for line in (columns, *rows)]


def assert_same_sea(record):
    """Within the digits that the files have."""
    sea = jonswap()
    assert record.spectrum.significant_height == pytest.approx(sea.significant_height, rel=1e-5)
    assert record.spectrum.peak_period == pytest.approx(sea.peak_period, rel=1e-5)
    np.testing.assert_allclose(record.frequency_hz, sea.frequency_hz, rtol=1e-12)
    np.testing.assert_allclose(record.density, sea.density, rtol=1e-4, atol=1e-5)


def refused(read, path, complaint):
    """In one line that begins with the file."""
    with pytest.raises(ParameterError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}{complaint}")
    assert "\n" not in str(caught.value)


# Datawell


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8"])
def test_datawell(written, encoding):
    record = read_datawell(written("buoy.spt", [*datawell_lines(), ""], encoding), NOON)
    assert_same_sea(record)
    assert record.time == NOON
    assert len(record.density) == 64


def changed(lines, number, text):
    return [*lines[: number - 1], text, *lines[number:]]


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        (datawell_lines()[1:], ":12: not a Datawell .spt file: expected 12 lines of one number"),
        (table_lines(), ":1: not a Datawell .spt file"),
        (datawell_lines()[:12], ":12: ends in its header"),
        (["1", "200"], ":2: ends in its header"),
        (["0", *datawell_lines()], ":13: '68.9"),
        (datawell_lines()[:13], ": a spectrum needs two or more rows; found 1"),
        (changed(datawell_lines(), 2, "two"), ":2: 'two' is not a number"),
        (changed(datawell_lines(), 4, ""), ":4: '' is not a number"),
        (changed(datawell_lines(), 15, "0.035,x,1,1,1,1"), ":15: 'x' is not a number"),
        (changed(datawell_lines(), 15, "0.035, 0.1"), ":15: '0.035, 0.1': expected 'f, S/Smax"),
        (["1"] * 12 + [""], ": a spectrum needs two or more rows; found 0"),
        (changed(datawell_lines(), 76, "inf,0,1,1,1,1"), ":76: frequency: must be finite and not"),
        (changed(datawell_lines(), 15, "0.035,inf,1,1,1,1"), ":15: density: must be finite"),
        # H_s in m, S_max in cm^2/Hz, H_s missing
        (changed(datawell_lines(), 2, "2.00"), ":2: H_s is 0.02 m, but the spectrum's 2.00 m"),
        (changed(datawell_lines(), 4, "51240"), ":2: H_s is 2 m, but the spectrum's"),
        (changed(datawell_lines(), 2, "nan"), ":2: H_s is nan m"),
    ],
)
def test_wrong_datawell_files(written, lines, complaint):
    refused(read_datawell, written("buoy.spt", lines), complaint)


@pytest.mark.parametrize(
    ("factor", "accepted"), [(0.84, True), (1.24, True), (0.8, False), (1.26, False)]
)
def test_datawell_height_may_differ_by_a_fifth(written, factor, accepted):
    """The buoy's own sum is not ours; 0.8 of the height is 25 % below the spectrum's."""
    height = f"{100 * factor * jonswap().significant_height:.2f}"
    path = written("buoy.spt", changed(datawell_lines(), 2, height))
    if accepted:
        assert_same_sea(read_datawell(path))
    else:
        with pytest.raises(ParameterError, match="H_s"):
            read_datawell(path)


def test_a_calm_sea_is_a_spectrum(written):
    lines = changed(changed(datawell_lines(), 2, "0"), 4, "0")
    assert read_datawell(written("buoy.spt", lines)).spectrum.significant_height == 0


# Tables


def test_table_with_and_without_header(written):
    headed = read_table(written("headed.csv", ["", *table_lines()[1:], ""]))
    assert_same_sea(headed)
    assert headed.time is None
    assert read_table(written("table.csv", table_lines())) == headed
    assert read_table(written("bare.csv", table_lines()[1:])) == headed
    # as spreadsheets write it
    assert read_table(written("marked.csv", table_lines(), "utf-8-sig")) == headed


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        ([], ": a spectrum needs two or more rows; found 0"),
        (["0.1, 1"], ": a spectrum needs two or more rows; found 1"),
        (["omega, S", "1, 2"], ":1: 'omega, S': expected two numbers, 'f_hz, S_m2_per_hz'"),
        (["0.1, 1", "f_hz, S_m2_per_hz"], ":2: 'f_hz, S_m2_per_hz': expected two numbers"),
        (["0.1, 1", "0.2"], ":2: '0.2': expected two numbers"),
        (["0.1, 1", "0.2, 1, 3"], ":2: '0.2, 1, 3': expected two numbers"),
        (["0.1; 1", "0.2; 1"], ":1: '0.1; 1': expected two numbers"),
        (["0.1, 1", "0.1, 1"], ":2: frequency: must be above the row's before it"),
        (["0.1, 1", "nan, 1"], ":2: frequency: must be finite"),
        (["-0.1, 1", "0.1, 1"], ":1: frequency: must be finite and not negative"),
        (["0.1, -1", "0.2, 1"], ":1: density: must be finite and not negative"),
        (["0.1, 1", "0.2, nan"], ":2: density: must be finite and not negative"),
    ],
)
def test_wrong_tables(written, lines, complaint):
    refused(read_table, written("sea.csv", lines), complaint)


def test_the_shortest_table_has_two_rows_and_may_begin_at_zero(written):
    record = read_table(written("sea.csv", ["0, 2", "0.1, 0"]))
    assert (record.frequency_hz, record.density) == ((0.0, 0.1), (2.0, 0.0))


# WaveNet

HALF_HOURS = (
    ("2021-03-05 11:30:00", "5.0", "7.5", "1.80"),
    ("05/03/2021 12:00", "5.97", "8.0", "2.00"),
    ("", "", "", ""),
    ("05/03/2021 12:30:00", "6.0", "", "2.10"),
    ("2021-03-05T13:00", "6.0", "8.5", ""),
    ("06/03/2021 13:00Z", "6.0", "NaN", "1.5"),
)


@pytest.mark.parametrize(
    ("minutes", "expected"),
    [
        ((10, 31), SeaState(NOON.replace(hour=11, minute=30), 1.8, 7.5)),
        ((11, 44), SeaState(NOON.replace(hour=11, minute=30), 1.8, 7.5)),
        ((11, 46), SeaState(NOON, 2.0, 8.0)),
        ((12, 14), SeaState(NOON, 2.0, 8.0)),
    ],
)
def test_wavenet_takes_the_nearest_record(written, minutes, expected):
    path = written("bulk.txt", wavenet_lines(HALF_HOURS))
    assert read_wavenet(path, datetime(2021, 3, 5, *minutes)) == expected
    assert read_wavenet(path, datetime(2021, 3, 5, *minutes, tzinfo=UTC)) == expected


def test_wavenet_height_of_older_exports_and_commas(written):
    columns = ("Time (GMT)", "Significant wave height (m)", "Dominant (peak) wave period (s)")
    row = ("2021-03-05 12:00", "0.50", "8.0")
    expected = SeaState(NOON, 0.5, 8.0)
    assert read_wavenet(written("a.txt", wavenet_lines([row], columns)), NOON) == expected
    assert read_wavenet(written("b.csv", [",".join(columns), ",".join(row)]), NOON) == expected


@pytest.mark.parametrize(
    ("lines", "time", "complaint"),
    [
        ([], NOON, ":1: not a WaveNet export: expected a column 'Time (GMT)'"),
        (wavenet_lines((), COLUMNS[:2]), NOON, ":1: not a WaveNet export: expected a column 'Dom"),
        (wavenet_lines((), COLUMNS[:3]), NOON, ":1: not a WaveNet export: expected a column 'Sig"),
        (wavenet_lines(()), NOON, ": no record within an hour of 2021-03-05 12:00:00"),
        (wavenet_lines(HALF_HOURS), datetime(2021, 3, 5, 10, 29), ": no record within an hour"),
        (wavenet_lines(HALF_HOURS), datetime(2021, 3, 5, 14, 1), ": no record within an hour"),
        (
            wavenet_lines(HALF_HOURS),
            NOON.replace(minute=20),
            f":5: {PEAK} is missing at 05/03/2021",
        ),
        (wavenet_lines(HALF_HOURS), NOON.replace(hour=14), f":6: {TALL} is missing at 2021-03-05T"),
        (wavenet_lines(HALF_HOURS), datetime(2021, 3, 6, 13), f":7: {PEAK} is missing at"),
        (wavenet_lines([("05/03/2021 12:00",)]), NOON, f":2: {TALL}"),
        (wavenet_lines([("noon", "5", "8", "2")]), NOON, ":2: 'noon' is not a time, DD/MM/YYYY"),
        (wavenet_lines([("03/25/2021 12:00", "5", "8", "2")]), NOON, ":2: '03/25/2021 12:00' is"),
        (["x\t" + wavenet_lines()[0], "1"], NOON, ":2: '' is not a time"),
        (wavenet_lines([("2021-03-05 12:00", "5", "8", "low")]), NOON, ":2: 'low' is not a number"),
        (
            wavenet_lines([("2021-03-05 12:00", "5", "0", "2")]),
            NOON,
            f":2: {PEAK} is 0: expected a",
        ),
        (
            wavenet_lines([("2021-03-05 12:00", "5", "8", "-9")]),
            NOON,
            f":2: {TALL} is -9: expected",
        ),
        (wavenet_lines([("2021-03-05 12:00", "5", "8", "inf")]), NOON, f":2: {TALL} is inf: expe"),
    ],
)
def test_wrong_wavenet_files(written, lines, time, complaint):
    refused(partial(read_wavenet, time=time), written("bulk.txt", lines), complaint)


@pytest.mark.parametrize("gamma", [1.0, 3.3, 6.0])
def test_the_curve_of_a_sea_state(gamma):
    record = SeaState(NOON, HEIGHT, PERIOD).record(gamma)
    assert record.time == NOON
    assert record.spectrum.significant_height == pytest.approx(HEIGHT, rel=1e-12)
    assert record.spectrum.peak_period == pytest.approx(PERIOD, rel=1e-3)
    top = int(np.argmax(record.density))
    assert record.frequency_hz[top] == pytest.approx(1 / PERIOD, rel=1e-14)
    frequency = np.linspace(0.05, 0.6, 200)
    exact = jonswap_density(frequency, HEIGHT, PERIOD, gamma)
    found = record.spectrum.density_at(frequency)
    np.testing.assert_allclose(found, exact, rtol=2e-3, atol=1e-4 * exact.max())


def test_a_sea_state_makes_the_same_sea_by_parameters_and_by_record(parameters):
    state = SeaState(NOON, HEIGHT, PERIOD)
    chosen = state.parameters(parameters)
    assert chosen == replace(parameters, significant_height=HEIGHT, peak_period=PERIOD)
    exact = Sea.random(chosen, GRAVITY)
    sea = measured_sea(state.record(parameters.peak_enhancement), chosen, GRAVITY)
    np.testing.assert_allclose(sea.amplitude, exact.amplitude, rtol=2e-3, atol=1e-4)
    np.testing.assert_array_equal(sea.phase, exact.phase)


# One function for all, and the list of names


def test_the_format_is_found(written):
    spt = datawell_lines()
    packed = written("packed.SPT.gz", [])
    packed.write_bytes(gzip.compress("\n".join(spt).encode("latin-1")))
    plain, capital = written("a.spt", spt, "latin-1"), written("B.SPT", spt)
    table, bare = written("c.csv", table_lines()), written("d.txt", table_lines()[1:])
    for path in (plain, capital, packed, table, bare):
        record = read_spectrum(path, NOON)
        assert_same_sea(record)
        assert record.time == NOON
    bulk = read_spectrum(written("e.txt", wavenet_lines()), NOON, peak_enhancement=5.0)
    assert bulk == SeaState(NOON, HEIGHT, PERIOD).record(5.0)
    ndbc = ["#YY MM DD hh mm .1 .2", "2021 03 05 12 00 1.0 2.0"]
    assert read_spectrum(written("f.txt", ndbc)).density == (1.0, 2.0)
    assert read_spectrum(written("g.txt", ["YY" + ndbc[0][1:], ndbc[1]])).time == NOON


def test_a_format_that_is_named_is_not_searched_for(written):
    assert_same_sea(read_spectrum(written("a.txt", datawell_lines()), NOON, "datawell"))
    path = written("b.csv", table_lines())
    for name, complaint in (
        ("ndbc", "not an NDBC spectral file"),
        ("datawell", "not a Datawell .spt file"),
        ("wavenet", "not a WaveNet export"),
    ):
        with pytest.raises(ParameterError, match=complaint):
            read_spectrum(path, NOON, name)
    assert_same_sea(read_spectrum(path, NOON, "table"))


def test_what_has_no_known_format(written):
    for lines in ([], ["0.1 2.0", "0.2 1.0"]):
        path = written("sea.txt", lines)
        with pytest.raises(ParameterError, match=r"sea\.txt:1: unknown format: expected"):
            read_spectrum(path)
    with pytest.raises(ParameterError, match="WaveNet export holds many records: name a time"):
        read_spectrum(written("bulk.txt", wavenet_lines()))


def test_every_format_can_be_named_in_the_list(written, parameters):
    written("buoy.spt", datawell_lines(), "latin-1")
    written("sea.dat", table_lines())
    written("bulk.txt", wavenet_lines())
    lines = [
        "spt = {file = 'buoy.spt'}",
        "table = {file = 'sea.dat', file_format = 'table', time = 2021-03-05T13:00:00+01:00}",
        "mean = {file = 'bulk.txt', time = 2021-03-05T12:10:00Z}",
        "peaked = {file = 'bulk.txt', time = 2021-03-05T12:10:00, peak_enhancement = 7}",
    ]
    records = named_records(written("records.toml", lines))
    assert [record.time for record in records.values()] == [None, NOON, NOON, NOON]
    for name in ("spt", "table"):
        assert_same_sea(records[name])
    state = SeaState(NOON, HEIGHT, PERIOD)
    assert records["mean"] == state.record(3.3)
    assert records["peaked"] == state.record(7.0)
    for record in records.values():
        sea = measured_sea(record, parameters, GRAVITY)
        height = 4 * math.sqrt(np.sum(sea.amplitude**2) / 2)
        assert height == pytest.approx(parameters.significant_height, rel=1e-12)


def test_a_record_without_a_time_is_named_so(written, parameters):
    calm = read_table(written("calm.csv", ["0.1, 0", "0.2, 0"]))
    with pytest.raises(ParameterError, match="record of no time: a spectrum without waves"):
        measured_sea(calm, parameters, GRAVITY)
