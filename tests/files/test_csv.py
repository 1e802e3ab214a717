"""CSV as programs and people write it: read right where that is possible, else one error with file, line and channel."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import linkwise as lw
from linkwise.arrays import Floats

Reader = Callable[..., lw.Record]
N = 60
T = np.arange(N) / 100.0
X = np.round(np.sin(20.0 * T), 6)
F = np.round(np.cos(9.0 * T), 6)


def body(*, delimiter: str = ",", comma: bool = False, rows: dict[int, str] | None = None) -> list[str]:
    """Lines of `time, x, f`; with `rows` some of them replaced."""
    lines = [delimiter.join(f"{value:.6f}" for value in row) for row in zip(T, X, F, strict=True)]
    if comma:
        lines = [line.replace(".", ",") for line in lines]
    for i, line in (rows or {}).items():
        lines[i] = line
    return lines


@pytest.fixture
def read(tmp_path: Path) -> Reader:
    """Write the text (or bytes) to a file and read it."""

    def write_and_read(content: str | bytes, name: str = "run.csv", **options: Any) -> lw.Record:
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return lw.read_record(path, **options)

    return write_and_read


def text(header: str, lines: list[str], end: str = "\n") -> str:
    return end.join([header, *lines]) + end


def check(record: lw.Record) -> None:
    assert record.channels == ("x:m1", "force:m1")
    assert record.rate == 100.0
    assert record.start == 0.0
    assert np.array_equal(record.channel("x:m1"), X)
    assert np.array_equal(record.channel("force:m1"), F)


HEADER = "time,x:m1,force:m1"


COMMAS = "Commas were read as decimal points."
SPELLINGS = [
    (text(HEADER, body()), None),
    (text(HEADER, body(), end="\r\n"), None),
    (text(HEADER, body()) + "\n\n  \n", None),
    (text(" time , x:m1 , force:m1", body(delimiter=" , ")), None),
    (text('"time","x:m1","force:m1"', ['"' + line.replace(",", '","') + '"' for line in body()]), None),
    (text(HEADER.replace(",", "\t"), body(delimiter="\t")), None),
    (text(HEADER.replace(",", " "), body(delimiter="   ")), None),
    (text(HEADER.replace(",", ";"), body(delimiter=";", comma=True)), COMMAS),
    (text(HEADER.replace(",", "\t"), body(delimiter="\t", comma=True)), COMMAS),
    (text("sep=;\n" + HEADER.replace(",", ";"), body(delimiter=";")), None),
    (text("# a comment\n% another\n\n" + HEADER, ["# and one more", *body(), "// the end"]), None),
    (text("# " + HEADER, body()), None),
    (text(HEADER + ",", [line + "," for line in body()]), None),
    (text(HEADER, [line + ",," for line in body()]), None),
    (text("Scope 7\nGain 3, 4\n" + HEADER, body()), "Lines of text skipped above the header: 2."),
    (text("Time (s),x:m1 (m),force:m1[N]", body()), None),
    *((text(HEADER, body()).encode(code), None) for code in ("utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32")),
    (b"\xfe\xff" + text(HEADER, body()).encode("utf-16-be"), None),
]  # fmt: skip


@pytest.mark.parametrize(("content", "note"), SPELLINGS)
def test_the_same_record_in_many_hands(read: Reader, content: str | bytes, note: str | None) -> None:
    record = read(content)
    check(record)
    assert record.notes == (() if note is None else (note,))


def test_units_in_headers_and_decimal_commas_in_quotes(read: Reader) -> None:
    rows = [
        f"{1000 * t:.10g},{1000 * x:.10g},{f:.10g},{f:.10g},{x:.10g}" for t, x, f in zip(T, X, F, strict=True)
    ]
    record = read(text("time[ms],x:m1[mm],a:m1[g],a:m2[m/s^2],force:m1 [kN]", rows))
    assert np.array_equal(record.time, T)
    assert record.rate == 100.0
    # The digits of the file over 1000, rounded once; 9.80665 m/s^2 is the standard gravity, not a gram.
    assert record.channel("x:m1") == pytest.approx(X, rel=1e-15)
    assert record.channel("a:m1") == pytest.approx(9.80665 * F, rel=1e-12)
    assert np.array_equal(record.channel("a:m2"), F)
    assert record.channel("force:m1") == pytest.approx(1000.0 * X, rel=1e-12)
    micro = text("time,x:m1[\u00b5m],force:m1", body()).encode("cp1252")  # the sign of an old instrument
    assert read(micro).channel("x:m1") == pytest.approx(1e-6 * X, rel=1e-12)
    lines = [",".join(f'"{cell.replace(".", ",")}"' for cell in line.split(",")) for line in body()]
    check(read(text(HEADER, lines)))


@pytest.mark.parametrize("cell", ["", "  ", "NaN", "nan", "NA", "n/a", "#N/A", "null", "-"])
def test_a_missing_sample_is_missing(read: Reader, cell: str) -> None:
    record = read(text(HEADER, body(rows={7: f"0.07,{cell},{F[7]}"})))
    assert np.argwhere(record.missing).tolist() == [[7, 0]]
    assert record.notes == ("x:m1: 1 of 60 samples are missing.",)
    assert np.array_equal(record.channel("force:m1"), F)


def test_gaps_in_time_become_missing_samples_and_milliseconds_are_asked_about(read: Reader) -> None:
    lines = body()
    del lines[20:23]
    record = read(text(HEADER, lines))
    assert len(record) == N
    assert np.flatnonzero(record.missing.all(axis=1)).tolist() == [20, 21, 22]
    assert record.notes == ("Gaps in time: 1, the first after 0.19 s; 3 rows were added as missing samples.",)
    (note,) = read(text("time,x:m1", [f"{i},{x}" for i, x in enumerate(X)])).notes
    assert note == "The sampling interval is 1 s. If the times are in ms, name their column time[ms]."


def test_times_rounded_in_printing_are_even(read: Reader) -> None:
    n, rate = 5000, 610.3515625
    t = np.arange(n) / rate
    record = read(text("time,x:m1", [f"{a:.4f},{np.sin(9 * a):.9f}" for a in t]))
    # the last time is good to half a digit
    assert record.rate == pytest.approx(rate, abs=0.5e-4 * rate / t[-1])
    assert record.notes == (
        f"The times are up to {np.max(np.abs(np.round(t, 4) - record.time)):.2g} s off an even grid, "
        f"as rounding causes; {record.rate:.9g} Hz was assumed.",
    )


@pytest.mark.parametrize(
    ("more", "note"),
    [("count,day", "count, day"), ("Force:m2 [kN],X:", "Force:m2 [kN] (did you mean force:m2?), X:")],
)
def test_columns_that_are_no_channels_are_ignored(read: Reader, more: str, note: str) -> None:
    record = read(text(f"{HEADER},{more}", [f"{line},{i},mon" for i, line in enumerate(body())]))
    check(record)
    assert record.notes == (f"Columns that are not channels were ignored: {note}.",)


def test_columns_are_mapped_by_name_and_number(read: Reader) -> None:
    content = text("Clock [ms];LVDT 3;Load cell (kN)", body(delimiter=";"))
    record = read(content, channels={"time[s]": "Clock", "x:m1[mm]": "LVDT 3", "force:m1": 3})
    assert np.array_equal(record.time, T)
    assert record.channel("x:m1") == pytest.approx(1e-3 * X, rel=1e-15)
    assert record.channel("force:m1") == pytest.approx(1e3 * F, rel=1e-15)
    check(read("\n".join(body()), channels={"time": "1", "x:m1": 2, "force:m1": 3}))  # without a header
    with pytest.raises(lw.RecordError, match="the name of 2 columns; give the number of the column instead"):
        read(text("time,probe,probe", body()), channels={"x:m1": "probe"})
    assert np.array_equal(read(text("time,probe,probe", body()), channels={"x:m1": 3}).channel("x:m1"), F)
    # a mapped channel wins over a header
    record = read(text(HEADER, body()), channels={"x:m1": "force:m1"})
    assert record.channels == ("x:m1",)
    assert np.array_equal(record.channel("x:m1"), F)
    assert record.notes == ("Columns that are not channels were ignored: x:m1.",)
    known = read(text("time,x:m1,x:base", body()), known_masses=["m1"])
    assert known.channels == ("x:m1", "x:base")


def test_the_rate_stands_in_for_a_time_column(read: Reader) -> None:
    lines = [line.partition(",")[2] for line in body()]
    check(read(text("x:m1,force:m1", lines), rate=100.0))
    single = read(text("x:m1", [str(x) for x in X]), rate=100.0)
    assert np.array_equal(single.channel("x:m1"), X)
    clock = [f"12:00:{i:02d},{line}" for i, line in enumerate(lines)]
    record = read(text(HEADER, clock), rate=100.0)
    check(record)
    assert record.notes == ("The time column was ignored in favour of the given rate of 100 Hz.",)


def changed(row: int, line: str, header: str = HEADER) -> str:
    """A file with one line of its body replaced."""
    return text(header, body(rows={row: line}))


PAIRS = [(f"{t:.2f}", x) for t, x in zip(T, X, strict=True)]
REFUSED = [
    ("", "run.csv: the file is empty"),
    ("\n \n", "run.csv: the file contains only blank lines"),
    (HEADER + "\n", "run.csv, line 1: there are no data below the header"),
    (text(HEADER, body()[:20]), "run.csv: 20 samples are too few; a record needs at least 32"),
    (b"\x00\x01\x02\x03" * 50, "run.csv: is a binary file, not text; its suffix may be wrong"),
    (text(HEADER, body()).encode("utf-8-sig") + b"\xff", "run.csv, line 62: is not valid utf-8 text"),
    ("\n".join(body()), "line 1: there is no header: the file starts with '0.000000,0.000000,1.000000'. The first line must"),
    ("\n".join(body()), "map columns by number, as in channels={'time': 1, 'x:m1': 2}"),
    (text("time,left,right", body()), "line 1: no channel is recognised; the columns are time, left, right. Channels"),
    (text("time,left,right", body()), "map columns of other names, as in channels={'x:m1': 'laser'}"),
    (text("time,x:m1,x:m1", body()), "line 1, channel x:m1: columns 2 and 3 both have this name; rename one"),
    (text("clock,x:m1,force:m1", body()), "there is no time column; the columns are clock, x:m1, force:m1. Name it `time`"),
    (changed(4, "time,x:m1,v:m2"), "line 6, channel x:m1: 'x:m1' is not a number; the header stands there again"),
    (changed(4, "0.04,abc,1"), "line 6, channel x:m1: 'abc' is not a number; leave the cell of a missing"),
    (changed(4, "noon,0.1,1"), "line 6, channel time: 'noon' is not a number; times are in seconds; for clock"),
    (changed(4, "0.04,0.1,inf"), "line 6, channel force:m1: the value is infinite; leave the cell of an overloaded sample"),
    (
        changed(4, "0.04,-9.9E+37,1", "time,x:m1[mm],force:m1"),
        "line 6, channel x:m1: the value is -9.9e+37, which instruments write for an overload or no reading",
    ),
    (changed(4, "0.04,0.1"), "line 6: 2 cells where the header has 3"),
    (changed(4, "OVERLOAD"), "line 6: 1 cell where the header has 3; leave the cell of a missing reading empty"),
    (changed(N - 1, "0.59"), "line 61: 1 cell where the header has 3; was the file truncated in its last"),
    (text(HEADER, body(comma=True)), "line 2: 6 cells where the header has 3; with decimal commas, separate the cells"),
    (changed(4, "0.03,0.1,1"), "line 6, channel time: the time 0.03 s is repeated"),
    (changed(4, "0.02,0.1,1"), "line 6, channel time: time decreases from 0.03 to 0.02 s"),
    (changed(4, "0.043,0.1,1"), "line 6, channel time: uneven time: a step of 0.013 s where 0.01 s"),
    (changed(4, "0.043,0.1,1"), "was expected; resample it to an even rate (`resample`)"),
    (changed(4, ",0.1,1"), "line 6, channel time: the time is missing; fill it in or"),
    (changed(N - 1, "59.0,1,2"), "line 61, channel time: a gap of 58.42 s in a record of 60 samples"),
    (text("time,x:m1[kg],force:m1", body()), "line 1, channel x:m1: 'kg' is not a unit of displacement; expected m or a"),
    (text("time[m],x:m1,force:m1", body()), "line 1, channel time: 'm' is not a unit of time; expected s or a unit that"),
    (text("time,x:m1", [f"{t},0.5" for t, _ in PAIRS]), "channel x:m1: every sample is 0.5: a constant channel carries no"),
    (text("time,x:m1", [f"{t}," for t, _ in PAIRS]), "channel x:m1: every sample is missing; leave the channel out"),
    (text("time,x:m1,x:m2", [f"{t},{x},{x}" for t, x in PAIRS]), "x:m2: has the same samples as x:m1"),
    (
        text("time,x:m1,x:m2[mm]", [f"{t},{x:.6f},{1000 * x:.3f}" for t, x in PAIRS]),
        "x:m2: has the same samples as x:m1; one of the two is mislabelled",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("content", "message"), REFUSED)
def test_what_cannot_be_read_is_one_clear_error(read: Reader, content: str | bytes, message: str) -> None:
    with pytest.raises(lw.RecordError) as caught:
        read(content)
    said = str(caught.value)
    assert message in said and "run.csv" in said and "\n" not in said


OPTIONS = [
    (
        {"channels": {"x:m2": "force"}},
        "x:m2 is mapped to column 'force', which does not exist; did you mean \"force:m1\"?; the columns",
    ),
    ({"channels": {"x:m2": 4}}, "x:m2 is mapped to column '4', which does not exist; the columns are time, x:m1, force:m1"),
    ({"channels": {"m2": 2}}, "in `channels`: 'm2' is not a channel: expected KIND:MASS"),
    ({"channels": {"x:m2": 2, "x:m2[mm]": 3}}, "channel x:m2: is mapped twice in `channels`"),
    ({"rate": -1.0}, "rate must be between 1e-30 and 1e+30 Hz, got -1 Hz"),
    ({"resample": 50.0}, "resampling to 50 Hz would alias content above 25 Hz, since the record has 100 Hz"),
    (
        {"resample": 400.0},
        "the record has 100 Hz and even times: samples at 400 Hz would be interpolated and add no information",
    ),
    ({"known_masses": ["m2", "n1"]}, "channel x:m1: the structure has no mass 'm1'; did you mean "),
]  # fmt: skip


@pytest.mark.parametrize(("options", "message"), OPTIONS)
def test_options_that_do_not_fit_are_refused(read: Reader, options: dict[str, Any], message: str) -> None:
    with pytest.raises(lw.RecordError) as caught:
        read(text(HEADER, body()), **options)
    assert message in str(caught.value)


# Resampling ----------------------------------------------------------------------------------------------------


def uneven(n: int = 400, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.uniform(0.7e-3, 1.3e-3, n))


def sine_at(times: Floats) -> str:
    return text("time,x:m1", [f"{a!r},{math.sin(60.0 * a)!r}" for a in times.tolist()])


def test_an_uneven_time_is_resampled_gaps_stay_open_and_a_rate_far_above_is_refused(read: Reader) -> None:
    t = uneven()
    record = read(sine_at(t), resample=2000.0)
    assert record.rate == 2000.0
    assert record.start == t[0]
    expected = np.sin(60.0 * record.time)
    # Quintic splines: error of order (60 h)^6 with h = 1.3e-3 at most, a little more at the ends.
    assert np.max(np.abs(record.channel("x:m1") - expected)) < 10.0 * (60.0 * 1.3e-3) ** 6
    assert record.notes == (
        "Resampled from 400 samples to 2000 Hz by quintic splines; "
        "noise of neighbouring samples is no longer independent.",
    )
    message = r"2500 Hz is finer than needed, .* resample to at most 24\d\d\.?\d* Hz"
    with pytest.raises(lw.RecordError, match=message):
        read(sine_at(t), resample=2500.0)
    t = np.delete(t, np.arange(100, 130))
    record = read(sine_at(t), resample=1000.0)
    hole = (record.time > t[99] + 1e-9) & (record.time < t[100] - 1e-9)
    assert np.array_equal(record.missing[:, 0], hole)
    assert hole.sum() > 20


# Writing, work, real files -------------------------------------------------------------------------------------


def test_the_measured_records_are_read(shared_data: Path) -> None:
    beam = lw.read_record(shared_data / "magnet_beam_decay.csv")
    assert (beam.channels, beam.rate, len(beam), beam.notes) == (("x:m1",), 1000.0, 3000, ())
    silver = lw.read_record(shared_data / "silverbox_multisine.csv")
    assert (silver.channels, silver.rate, len(silver)) == (("force:m1", "x:m1"), 1.0 / 0.0016384, 65062)
    assert silver.inputs == ("force:m1",)


@pytest.mark.parametrize(("above", "below"), [("\N{INFINITY}", "-\N{INFINITY}"), ("inf", "-Infinity")])
def test_what_an_oscilloscope_had_no_range_for_is_a_bound(above: str, below: str, tmp_path: Path) -> None:
    time = np.arange(200) / 100.0
    motion = np.sin(9.0 * time)
    cells = [above if x > 0.8 else below if x < -0.9 else f"{x:.6f}" for x in motion]
    rows = [
        f"{t:.2f},{cell}" for t, cell in zip(time, cells, strict=True) if t != 1.0
    ]  # a row that is not there
    path = tmp_path / "scope.csv"
    path.write_text("time,x:m1[mm]\n" + "\n".join(rows) + "\n", encoding="utf-8")
    record = lw.read_record(path)
    samples, clipped = record.channel("x:m1"), record.clipped["x:m1"]
    there = time != 1.0
    assert np.array_equal(np.isnan(samples), (motion > 0.8) | (motion < -0.9) | ~there)
    assert np.array_equal(clipped.sides, np.where(there, (motion > 0.8) * 1.0 - (motion < -0.9), 0.0))
    assert set(clipped.readings[clipped.sides > 0.0]) == {np.nanmax(samples)}
    assert set(clipped.readings[clipped.sides < 0.0]) == {np.nanmin(samples)}
    assert clipped.of(samples) is clipped
    number = int(((motion > 0.8) | (motion < -0.9)).sum())
    assert f"x:m1: {number} samples were marked as missing (infinite," in " ".join(record.notes)
    assert dict(lw.read_record(path, resample=100.0).clipped) == {}
