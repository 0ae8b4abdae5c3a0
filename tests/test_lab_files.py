"""Files as laboratories have them, written here from synthetic numbers: each reads as the plain CSV does, or asks."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from record_files import DT, P_MMHG, R_MM, TIME, bench, text
from scipy.io import savemat
from typer.testing import CliRunner

from arterial_fmu.__main__ import app
from fitting.records.alignment.align import align
from fitting.records.read import numbers
from fitting.records.read.columns import Reading
from fitting.records.read.preview import preview, preview_questions
from fitting.records.read.record import Record, read_record
from fitting.records.read.sensors import KINDS
from fitting.records.read.titles import factor, name_and_unit
from solver.quantities.units import MMHG

PLAIN = {"AA.P": P_MMHG * MMHG, "AA.R": R_MM * 1e-3}
NAMES = {"P": "AA.P [mmHg]", "D": "AA.R [mm]"}


def read(folder: Path, content: str | bytes, name: str = "record.txt", **how: Any) -> Record:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_record(path, Reading(**how))


def check(record: Record, rtol: float = 1e-8) -> None:
    """Time step, pressure and radius are those of the plain file, to its printed digits."""
    assert record.dt == pytest.approx(DT, rel=1e-9)
    assert set(record.channels) == set(PLAIN)
    for name, values in PLAIN.items():
        np.testing.assert_allclose(record.channels[name], values, rtol=rtol)


def rows(separator: str, mark: str, decimals: int = 8) -> list[str]:
    table = np.column_stack([TIME, P_MMHG, R_MM])
    return [separator.join(f"{v:.{decimals}f}".replace(".", mark) for v in row) for row in table]


def refused(folder: Path, content: str | bytes, name: str = "record.txt", **how: Any) -> str:
    with pytest.raises(ValueError) as caught:
        read(folder, content, name, **how)
    sentence = str(caught.value)
    assert sentence.startswith(str(folder / name)) and sentence.endswith(".") and "\n" not in sentence
    return sentence


# --- dialects -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
@pytest.mark.parametrize(("separator", "mark"), [(";", ","), (";", "."), ("\t", ","), ("\t", "."), (",", ".")])
def test_european_csv(tmp_path: Path, separator: str, mark: str, encoding: str) -> None:
    """Separators, decimal marks and encodings; the radius in micrometres has a letter that is not ASCII."""
    table = np.column_stack([TIME, P_MMHG, 1e3 * R_MM])
    lines = [separator.join(f"{v:.8f}".replace(".", mark) for v in row) for row in table]
    header = separator.join(["Zeit [s]", "AA.P (mmHg)", "AA.R [µm]"])
    check(read(tmp_path, "\r\n".join([header, *lines]).encode(encoding)))


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    dialect=st.sampled_from([(";", ","), (";", "."), ("\t", ","), ("\t", "."), (",", ".")]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]),
    end=st.sampled_from(["\n", "\r\n", "\r"]),
    preamble=st.lists(st.sampled_from(["# a remark", "% made by hand", "Animal 7", "", "Date: today"]), max_size=4),
    brackets=st.sampled_from(["[]", "()"]),
    trailing=st.booleans(),
    gaps=st.sets(st.integers(0, 29), max_size=10),
)
def test_any_dialect_reads_back(
    seed: int, dialect: tuple[str, str], encoding: str, end: str, preamble: list[str], brackets: str, trailing: bool,
    gaps: set[int],
) -> None:  # fmt: skip
    """Any mixture of dialects: pressures bit for bit the numbers of the plain CSV, gaps where they were."""
    rng = np.random.default_rng(seed)
    P, R = rng.uniform(60.0, 140.0, 30), rng.uniform(8.0, 12.0, 30)
    P[sorted(gaps)] = np.nan
    cells = [[f"{0.005 * i:.3f}", "" if np.isnan(p) else repr(float(p)), repr(float(r))] for i, (p, r) in
             enumerate(zip(P, R, strict=True))]  # fmt: skip
    separator, mark = dialect
    last = separator if trailing else ""
    header = [
        f"{name} {brackets[0]}{unit}{brackets[1]}" for name, unit in (("t", "s"), ("AA.P", "kPa"), ("AA.R", "mm"))
    ]
    lines = [*preamble, separator.join(header) + last]
    lines += [separator.join(row).replace(".", mark) + last for row in cells]
    with tempfile.TemporaryDirectory() as folder:
        plain = read(Path(folder), "\n".join(["time [s],AA.P [kPa],AA.R [mm]", *map(",".join, cells)]))
        other = read(Path(folder), end.join(lines).encode(encoding))
    for name in ("AA.P", "AA.R"):
        np.testing.assert_array_equal(other.channels[name], plain.channels[name])


@pytest.mark.parametrize(
    ("title", "expected"),
    [
        ("t (ms)", ("t", "ms")),
        ("Time_s", ("Time", "s")),
        ("Zeit [ms]", ("Zeit", "ms")),
        ("Zeit / ms", ("Zeit", "ms")),
        ("p in mmHg", ("p", "mmHg")),
        ("Pressure mm Hg", ("Pressure", "mm Hg")),
        ("min", ("time", "min")),
        ("Pressure (left)", ("Pressure (left)", "")),
        ("P_m", ("P_m", "")),
        ("P_min", ("P_min", "")),
        ("AA.P", ("AA.P", "")),
        ("P (dyn/cm2)", ("P", "dyn/cm2")),
        ("Q (ml.min-1)", ("Q", "ml.min-1")),
    ],
)
def test_titles(title: str, expected: tuple[str, str]) -> None:
    """Name and unit; what may mean anything else is no unit."""
    assert name_and_unit(title) == expected


@pytest.mark.parametrize(
    ("title", "per_second"), [("t (ms)", 1e3), ("Time_s", 1.0), ("min", 1 / 60), ("Time [sec]", 1.0)]
)
def test_times(tmp_path: Path, title: str, per_second: float) -> None:
    """Milliseconds, seconds, minutes: dt in s to the printed digits."""
    check(read(tmp_path, text({title: TIME * per_second, "AA.P [mmHg]": P_MMHG, "AA.R [mm]": R_MM}, 12)))


@pytest.mark.parametrize("title", ["n", "row"])
def test_rows_without_a_time(tmp_path: Path, title: str) -> None:
    """Numbers of the samples, or no time at all, and the time between samples: as with times."""
    columns = {"P": P_MMHG, "D": R_MM}
    made = text({"n": np.arange(len(TIME)), **columns} if title == "n" else columns, 12)
    for step in ("5 ms", "200 Hz", "0.2 kHz"):
        check(read(tmp_path, made, names={**NAMES, title: f"time [{step}]"}))
    assert 'row = "0 Hz": must be a positive rate, such as "250 Hz".' in refused(
        tmp_path, made, names={**NAMES, "row": "time [0 Hz]"}
    )


def test_a_look_at_a_file_without_a_time(tmp_path: Path) -> None:
    """Without titles the first column, which does not rise, is no time; with names, the time is asked for."""
    path = tmp_path / "record.txt"
    path.write_text("\n".join(row.partition("\t")[2] for row in rows("\t", ".")))
    (question,) = preview_questions(preview(path, Reading()))
    assert question.endswith('--map "1=inlet.Q [mL/s]" --map "2=AA.P [mmHg]" --map "row=time [1 ms]".')
    names = {"1": "AA.P [mmHg]", "2": "AA.R [mm]"}
    (question,) = preview_questions(preview(path, Reading(names=names)))
    assert question.startswith("No column is a time, ") and '--map "row=time [250 Hz]"' in question
    assert preview_questions(preview(path, Reading(names=names | {"row": "time [200 Hz]"}))) == []


def test_labchart_and_acqknowledge(tmp_path: Path) -> None:
    """What LabChart and AcqKnowledge write above and beside the numbers; columns by the names of the channels."""
    chart = ["Interval=\t0.005 s", "ExcelDateTime=\t4.5e+004\t01/02/26 10:00:00.000", "TimeFormat=\tStartOfBlock",
             "ChannelTitle=\tP\tD", "Range=\t500 mmHg\t10.000 mm"]  # fmt: skip
    lines = rows("\t", ".")
    lines[7] += "\t#* injection "
    check(read(tmp_path, "\n".join([*chart, *lines]), names=NAMES))
    again = [line.replace("10:00:00", "10:00:02") for line in chart]  # a further block, whose times go on
    check(read(tmp_path, "\n".join([*chart, *lines[:400], *again, *lines[400:]]), names=NAMES))
    dated = [row.replace("\t", "\t2/6/2024\t", 1) for row in lines]  # DateFormat= of the day, in a column of its own
    check(read(tmp_path, "\n".join([*chart, *dated]), names=NAMES))
    timeless = [row.partition("\t")[2] for row in rows("\t", ".")]
    check(read(tmp_path, "\n".join([*chart, *timeless]), names=NAMES | {"row": "time [5 ms]"}))
    biopac = ["sheep7.acq", "5 msec/sample", "2 channels", "P", "mmHg", "D", "mm", "sec\tCH1\tCH2\t", "\t1000\t1000\t"]
    check(read(tmp_path, "\n".join([*biopac, *(f"{row}\t" for row in rows("\t", "."))]), names=NAMES))


@pytest.mark.parametrize("pause", [-1.5, 60.0], ids=["times that begin anew", "a long pause"])
def test_the_longest_of_several_blocks(tmp_path: Path, pause: float) -> None:
    """Of 300 samples and 700, the latter, with the line of its first."""
    time = TIME + np.where(np.arange(len(TIME)) < 300, 0.0, pause)
    lines = [f"{t:.3f},{p:.6f},{r:.6f}" for t, p, r in zip(time, P_MMHG, R_MM, strict=True)]
    record = read(tmp_path, "\n".join(["time [s],AA.P [mmHg],AA.R [mm]", *lines]))
    assert record.time == pytest.approx(time[300:], abs=1e-9) and len(record.said) == 1
    assert record.channels["AA.P"] == pytest.approx(P_MMHG[300:] * MMHG)
    assert "holds 2 blocks" in record.said[0] and "the longest, of 3.495 s from line 302 on, was read" in record.said[0]


def test_comments_units_below_and_savetxt(tmp_path: Path) -> None:
    """Comments above, among and behind the numbers; a line of units; a header that is a comment, as NumPy writes it."""
    lines = rows(",", ".")
    lines[5] += " # cough"
    header = ["% made by hand", "time,AA.P,AA.R", "s,mmHg,mm"]
    check(read(tmp_path, "\n".join([*header, *lines[:9], "# a remark", *lines[9:]])))
    np.savetxt(tmp_path / "s.txt", np.column_stack([TIME, P_MMHG, R_MM]), delimiter=",",
               header="time [s],AA.P [mmHg],AA.R [mm]")  # fmt: skip
    check(read_record(tmp_path / "s.txt"), 1e-7)


@pytest.mark.parametrize("mark", [".", ","])
def test_a_remark_costs_no_look_at_every_cell(tmp_path: Path, mark: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """One in a file of LabChart, and the lines of a further block: the rest is read as fast as without."""
    lines = rows("\t", mark)
    lines[300] += "\t#* infusion"
    head = [f"Interval=\t0{mark}005 s", "ChannelTitle=\tAA.P\tAA.R", "UnitName=\tmmHg\tmm"]
    monkeypatch.setattr(numbers, "_number", None)
    check(read(tmp_path, "\n".join([*head, *lines[:500], *head, *lines[500:]])))


def clock(start: float, t: float, mark: str) -> str:
    """12:03:04.250 of seconds since midnight."""
    ms = round(1e3 * (start + t)) % 86_400_000
    return f"{ms // 3_600_000:02d}:{ms // 60_000 % 60:02d}:{ms // 1000 % 60:02d}{mark}{ms % 1000:03d}"


@pytest.mark.parametrize("title", ["Time", "Time of day (hh:mm:ss)", "Zeit [hh:mm:ss,000]"])
@pytest.mark.parametrize(("separator", "mark"), [(";", ","), ("\t", ","), (",", "."), (" ", "."), (" ", ",")])
def test_clock_times(tmp_path: Path, separator: str, mark: str, title: str) -> None:
    """Hours, minutes and seconds with milliseconds, past midnight: dt to the printed digits, whatever the title."""
    lines = [separator.join([clock(86398.0, t, mark), f"{p:.8f}".replace(".", mark), f"{r:.8f}".replace(".", mark)])
             for t, p, r in zip(TIME, P_MMHG, R_MM, strict=True)]  # fmt: skip
    title = f'"{title}"' if separator == "," else title.replace("Time of day", "Clock")
    record = read(tmp_path, "\n".join([separator.join([title, "AA.P [mmHg]", "AA.R [mm]"]), *lines]))
    check(record)
    assert record.time[0] == pytest.approx(86398.0, abs=1e-9)


def half_day(t: float) -> str:
    """11:59:58.250 AM of seconds after 11:59:58."""
    hours, _, rest = clock(43198.0, t, ".").partition(":")
    return f"{int(hours) % 12 or 12}:{rest} {'AM' if int(hours) < 12 else 'PM'}"


@pytest.mark.parametrize(
    ("time", "first"),
    [
        (half_day, 43198.0),
        (lambda t: clock(58.0, t, ".")[3:], 58.0),
        (lambda t: clock(58.0, t, ":"), 58.0),
        (lambda t: f"01-May-2024 {clock(58.0, t, '.')}", 58.0),
        (lambda t: f"01/05/24 {clock(58.0, t, '.')}", 58.0),
    ],
    ids=["AM and PM", "minutes and seconds", "colon before milliseconds", "name of the month", "year of two digits"],
)
@pytest.mark.parametrize("date", ["", "5/1/2024,"], ids=["alone", "beside a date"])
def test_other_clocks(tmp_path: Path, time: Callable[[float], str], first: float, date: str) -> None:
    """Past noon, and minutes:seconds.decimals as spreadsheets show them, a date in a column of its own or not."""
    lines = [f"{date}{time(t)},{p:.8f},{r:.8f}" for t, p, r in zip(TIME, P_MMHG, R_MM, strict=True)]
    record = read(tmp_path, "\n".join([f"{'Date,' if date else ''}Time,AA.P [mmHg],AA.R [mm]", *lines]))
    check(record)
    assert record.time[0] == pytest.approx(first, abs=1e-9)


@pytest.mark.parametrize("remark", ["infusion on", '"infusion, on"', "5 mL bolus"])
def test_a_column_of_remarks(tmp_path: Path, remark: str) -> None:
    """Words among the samples, in a column that is no channel: left out; in one that is, line and column."""
    lines = [f"{line},{remark if i == 300 else ''}" for i, line in enumerate(rows(",", "."))]
    check(read(tmp_path, "\n".join(["time [s],AA.P [mmHg],AA.R [mm],Comment", *lines])))
    said = refused(tmp_path, "\n".join(["time [s],AA.P [mmHg],AA.R [mm],BT.P [mmHg]", *lines]))
    assert f"line 302, column 'BT.P [mmHg]': '{remark.strip(chr(34))}' is not a number" in said


@pytest.mark.parametrize(
    ("title", "unit", "time"),
    [
        ("Elapsed time", "seconds", lambda t: f"{t:.3f}"),
        ("Elapsed time", "hh:mm:ss.mmm", lambda t: f"'0:{t:06.3f}'"),
        ("Time and date", "hh:mm:ss.mmm dd/mm/yyyy", lambda t: f"'[{clock(3600.0, t, '.')} 01/05/2014]'"),
    ],
)
def test_physionet(tmp_path: Path, title: str, unit: str, time: Callable[[float], str]) -> None:
    """What rdsamp of WFDB writes, which is proposed for its records: single quotes, units below, clocks."""
    lines = [f"{time(t)},{p:.8f},{r:.8f}" for t, p, r in zip(TIME, P_MMHG, R_MM, strict=True)]
    check(read(tmp_path, "\n".join([f"'{title}','P','D'", f"'{unit}','mmHg','mm'", *lines]), names=NAMES))


@pytest.mark.parametrize("nothing", ["", ",,", "  "])
def test_rows_of_nothing(tmp_path: Path, nothing: str) -> None:
    """Blank lines and separators alone are no samples."""
    lines = rows(",", ".")
    lines[300:300] = [nothing]
    check(read(tmp_path, "\n".join(["time [s],AA.P [mmHg],AA.R [mm]", *lines])))


def test_a_separator_behind_the_numbers_alone(tmp_path: Path) -> None:
    """A tab at the end of each line of numbers, and none in the header: as without."""
    lines = [f"{row}\t" for row in rows("\t", ".")]
    check(read(tmp_path, "\n".join(["time [s]\tAA.P [mmHg]\tAA.R [mm]", *lines])))


@pytest.mark.parametrize("mark", [",", ";", "\t"])
def test_titles_separated_otherwise(tmp_path: Path, mark: str) -> None:
    """Titles between commas, semicolons or tabs, numbers between others: the titles are read."""
    other = ";" if mark != ";" else ","
    titles = mark.join(["time [s]", "AA.P [mmHg]", "AA.R [mm]"])
    check(read(tmp_path, "\n".join([titles, *rows(other, ".")])))


def test_two_separators_in_a_line(tmp_path: Path) -> None:
    """Fields between commas and semicolons at once are refused with the line."""
    lines = [row.replace(",", "; ", 1) for row in rows(",", ".")]
    said = refused(tmp_path, "\n".join(["time [s], AA.P [mmHg]; AA.R [mm]", *lines]))
    assert said.endswith("line 2: semicolons and commas separate its fields; export the table with one of them.")


@pytest.mark.parametrize("gap", ["-?-", "-.-", "?", "???"])
def test_what_monitors_write_for_nothing(tmp_path: Path, gap: str) -> None:
    """Question marks are gaps."""
    lines = rows(",", ".")
    lines[500] = f"{lines[500].partition(',')[0]},{gap},{gap}"
    found = read(tmp_path, "\n".join(["time [s],AA.P [mmHg],AA.R [mm]", *lines]))
    assert np.flatnonzero(np.isnan(found.channels["AA.P"])).tolist() == [500]


def test_spellings_of_units() -> None:
    """Of old papers and of keyboards without powers."""
    mL_per_min, kinds = 1e-6 / 60.0, (KINDS["P"], KINDS["Q"])
    for unit, value in {"dyn/cm2": 0.1, "N/m2": 1.0, "kpa": 1e3, "cmH20": 98.0665}.items():
        assert factor(unit, kinds[0]) == pytest.approx(value, rel=1e-4) and factor(unit, kinds[1]) is None
    for unit, value in {
        "ml.s-1": 1e-6,
        "mL·min-1": mL_per_min,
        "l min-1": 1e3 * mL_per_min,
        "LPM": 1e3 * mL_per_min,
    }.items():
        assert factor(unit, kinds[1]) == pytest.approx(value, rel=1e-9) and factor(unit, kinds[0]) is None


def test_a_velocity(tmp_path: Path) -> None:
    """It is no flow, and the sentence shows the area as a part of the unit; so given, it is one."""
    made = text({"Zeit [s]": TIME, "P [mmHg]": P_MMHG, "Doppler [cm/s]": 50.0 + R_MM}, 12)
    option = '--map "Doppler [cm/s]=inlet.Q [4 cm^2*cm/s]"'
    assert refused(tmp_path, made).endswith(
        f"a velocity becomes a flow by the area of its vessel, here 4 cm^2: {option}."
    )
    assert option in refused(tmp_path, made, names={"P": "Ao.P", "Doppler": "inlet.Q"})
    found = read(tmp_path, made, names={"P": "Ao.P", "Doppler": "inlet.Q [4 cm^2*cm/s]"})
    np.testing.assert_allclose(found.channels["inlet.Q"], 4e-6 * (50.0 + R_MM), rtol=1e-9)


def test_diameters_are_proposed_as_such(tmp_path: Path) -> None:
    """Titles of joined words; each at a site of its own, so that all options can be pasted."""
    made = text({"Time [s]": TIME, "AoP [kPa]": P_MMHG, "AoDiam [um]": R_MM, "AbdDiam [um]": R_MM, "Q2 [mL/s]": R_MM})
    asked = [
        f'--map "{x}"' for x in ("AoP [kPa]=Ao.P", "AoDiam [um]=Ao.D", "AbdDiam [um]=site2.D", "Q2 [mL/s]=inlet.Q")
    ]
    assert " ".join(asked) in refused(tmp_path, made)


def test_a_column_that_counts_is_no_pressure(tmp_path: Path) -> None:
    """As pandas writes its index, without a title: to leave it out is proposed."""
    columns = {"": np.arange(len(TIME)), "time [s]": TIME, "Pao": P_MMHG, "Qao": R_MM}
    assert '--map "column 1=" --map "Pao=Ao.P [mmHg]"' in refused(tmp_path, text(columns))


def test_rows_of_events(tmp_path: Path) -> None:
    """Words in place of a row, and beside the time of an event: no samples; beside a number, line and column."""
    lines = rows(",", ".")
    lines[300:300] = ["EVENT: 5 ug of noradrenaline", "1.4999,Marker,occlusion on"]
    lines.insert(600, "Washout,,")  # a heading of a spreadsheet
    content = "\n".join(["time [s],AA.P [mmHg],AA.R [mm]", *lines])
    check(read(tmp_path, content))
    assert "line 303, column 'AA.P [mmHg]': 'Marker' is" in refused(tmp_path, content.replace("occlusion on", "9.0"))


def test_lines_of_words_below_the_titles(tmp_path: Path) -> None:
    """Titles, units and names of the converter's channels, in any order below the titles; units above them."""
    for below in (["s,mmHg,mm", "Ch 1,Ch 2,Ch 3"], ["Ch 1,Ch 2,Ch 3", "(s),(mmHg),(mm)"]):
        check(read(tmp_path, "\n".join(["Sheep 12", "Time,AA.P,AA.R", *below, *rows(",", ".")])))
    check(read(tmp_path, "\n".join(["[s],[mmHg],[mm]", "Time,AA.P,AA.R", *rows(",", ".")])))  # or units above


def test_units_of_other_signals_in_a_line_of_units(tmp_path: Path) -> None:
    """An ECG, a heart rate and a temperature beside the channels leave these their units."""
    lines = [f"{line},0.1,120,38.1" for line in rows(",", ".")]
    content = "\n".join(["Time,P,D,ECG,HR,Temp", "s,mmHg,mm,mV,bpm,°C", *lines])
    check(read(tmp_path, content, names={"P": "AA.P", "D": "AA.R"}))
    found = preview(tmp_path / "record.txt", Reading())["columns"]
    assert [column["unit"] for column in found[1:]] == ["mmHg", "mm", "mV", "bpm", "°C"]


def test_what_stands_behind_the_samples(tmp_path: Path) -> None:
    """Blank lines and words at the end of the file are no samples; a last line that is cut short is refused."""
    lines = ["time [s],AA.P [mmHg],AA.R [mm]", *rows(",", ".")]
    check(read(tmp_path, "\n".join([*lines, "", "End of file", "Recorded by the lab"])))
    assert "2 fields where the header has 3" in refused(tmp_path, "\n".join([*lines, "5.0,80.0"]))


def test_a_probe_that_is_turned(tmp_path: Path) -> None:
    """-AA.Q is the flow with its sign turned, also without titles; its unit stays."""
    content = "\n".join(f"{t:.3f},{p:.8f}" for t, p in zip(TIME, P_MMHG, strict=True))
    record = read(tmp_path, content, names={"1": "time [s]", "2": "-AA.Q [mL/s]"})
    assert record.channels["AA.Q"] == pytest.approx(-1e-6 * P_MMHG) and record.scales == {"AA.Q": pytest.approx(1e-6)}


def test_two_columns_of_one_title(tmp_path: Path) -> None:
    """The option that is proposed leaves one of them out."""
    lines = [f"{line},1.0" for line in rows(",", ".")]
    content = "\n".join(["time [s],AA.P [mmHg],AA.R [mm],AA.R [mm]", *lines])
    assert '--map "4=" leaves this one out' in refused(tmp_path, content)
    check(read(tmp_path, content, names={"4": ""}))


def test_a_channel_with_times_of_its_own(tmp_path: Path) -> None:
    """Every fifth sample, one below the other beside times of its own: refused, not read by the other times."""
    rest = [f",{t:.3f},{r:.8f}" for t, r in zip(TIME[::5], R_MM[::5], strict=True)] + [",,"] * len(TIME)
    lines = [f"{t:.3f},{p:.8f}{end}" for t, p, end in zip(TIME, P_MMHG, rest, strict=False)]
    said = refused(tmp_path, "\n".join(["Time P [s],AA.P [mmHg],Time R [s],AA.R [mm]", *lines]),
                   names={"Time P": "time"})  # fmt: skip
    assert "column 'AA.R [mm]': it ends where the times of 'Time R [s]' do" in said and "--with" in said


@pytest.mark.parametrize("title", ["Pressure [V]", "Pressure (V)"])
def test_volts_are_asked_for_their_calibration(tmp_path: Path, title: str) -> None:
    """What one volt is, as the unit; an ECG beside is left out."""
    content = text({"time [s]": TIME, title: P_MMHG / 50.0, "ECG [V]": 0.0 * TIME, "Radius [mm]": R_MM})
    asked = "give what one V is as its unit, [50 mmHg] if that is 50 mmHg, or [mmHg] if it was calibrated"
    assert asked in refused(tmp_path, content)
    assert asked in refused(tmp_path, content, names={"Pressure": "AA.P", "Radius": "AA.R"})
    check(read(tmp_path, content, names={"Pressure": "AA.P [50 mmHg]", "Radius": "AA.R"}))


def test_columns_of_one_title_are_asked_for_by_number(tmp_path: Path) -> None:
    """The options that are proposed can be given together, and one by the title names those by number."""
    lines = [f"{line},{line.rpartition(',')[2]}" for line in rows(",", ".")]
    content = "\n".join(["time [s],Pressure [mmHg],Radius [mm],Radius [mm]", *lines])
    said = refused(tmp_path, content)
    assert '--map "Pressure [mmHg]=Ao.P" --map "3=Ao.R" --map "4=site2.R"' in said
    found = preview(tmp_path / "record.txt", Reading())
    assert '--map "3=Ao.R"' in "".join(preview_questions(found)) and '--map "Radius' not in str(found)
    assert 'by its number, --map "3=AA.R" or --map "4=AA.R"' in refused(tmp_path, content, names={"Radius": "AA.R"})
    check(read(tmp_path, content, names={"Pressure": "AA.P", "3": "AA.R"}))


@pytest.mark.parametrize("mark", ["--", "-", "NA", "n/a", "#N/A", "#DIV/0!", "#NV", "null", "***"])
@pytest.mark.parametrize("remark", ["", " # remark"], ids=["at once", "cell by cell"])
def test_marks_of_gaps(tmp_path: Path, mark: str, remark: str) -> None:
    """What programs write for no value is a gap, in the first sample, too."""
    lines = rows(",", ".")
    for i in (0, 400):
        t, _, radius = lines[i].split(",")
        lines[i] = f"{t},{mark},{radius}"
    lines[2] += remark
    record = read(tmp_path, "\n".join(["time [s],AA.P [mmHg],AA.R [mm]", *lines]))
    assert np.flatnonzero(np.isnan(record.channels["AA.P"])).tolist() == [0, 400]


@pytest.mark.parametrize(
    ("day", "after", "zone", "start"),
    [
        ("2024-05-01T", "2024-05-02T", "", 19844 * 86400.0 + 86398.0),
        ("2024-05-01 ", "2024-05-02 ", "Z", 19844 * 86400.0 + 86398.0),
        ("01.05.2024 ", "02.05.2024 ", "", 86398.0),
        ("5/1/2024 ", "5/2/2024 ", "+02:00", 86398.0),
        ("5/1/2024 ", "5/2/2024 ", " UTC", 86398.0),
    ],
)
@pytest.mark.parametrize(("separator", "mark"), [(";", ","), ("\t", "."), (",", ".")])
def test_dates_before_the_clock(
    tmp_path: Path, separator: str, mark: str, day: str, after: str, zone: str, start: float
) -> None:
    """ISO dates count from 1970, others may have the day or the month first and count as times of day; past midnight:
    dt to doubles. A column of dates alone is left out by a map."""
    lines = [[f"{day if t < 2.0 else after}{clock(86398.0, t, mark)}{zone}", f"{p:.8f}".replace(".", mark),
              f"{r:.8f}".replace(".", mark)] for t, p, r in zip(TIME, P_MMHG, R_MM, strict=True)]  # fmt: skip
    titles = ["Stamp", "AA.P [mmHg]", "AA.R [mm]"]
    record = read(tmp_path, "\n".join(map(separator.join, [titles, *lines])))
    assert record.dt == pytest.approx(DT, rel=1e-7)  # doubles of times since 1970 are 0.2 µs apart
    assert record.time[0] == pytest.approx(start, abs=1e-6)
    np.testing.assert_allclose(record.channels["AA.P"], PLAIN["AA.P"], rtol=1e-8)
    apart = [[first[: len(day) - 1], first[len(day) :], *rest] for first, *rest in lines]
    check(read(tmp_path, "\n".join(map(separator.join, [["Day", *titles], *apart])), names={"Day": ""}))


def test_clock_beside_a_time(tmp_path: Path) -> None:
    """Two times are asked; one is left out, or the clock is what the map says."""
    rows_ = [f"{clock(0.0, t, '.')},{t:.3f},{p:.8f},{r:.8f}" for t, p, r in zip(TIME, P_MMHG, R_MM, strict=True)]
    content = "\n".join(["Clock,time [s],AA.P [mmHg],AA.R [mm]", *rows_])
    assert "'Clock' and 'time [s]' are both a time; leave one out" in refused(tmp_path, content)
    check(read(tmp_path, content, names={"Clock": ""}))
    check(read(tmp_path, content, names={"Clock": "time"}))


@pytest.mark.parametrize(
    "header",
    [
        "time [s]   AA.P [mm Hg] AA.R [mm]",
        "# time_s AA.P_mmHg AA.R_mm",
        "time AA.P AA.R\ns mmHg mm",
        "Elapsed time (s)   AA.P (mmHg)   AA.R (mm)",
    ],
)
@pytest.mark.parametrize("gap", [" ", "   "])
@pytest.mark.parametrize("mark", [".", ","])
def test_columns_between_blanks(tmp_path: Path, header: str, gap: str, mark: str) -> None:
    """Fields between any number of blanks, also before the first; titles keep the unit behind them."""
    lines = ["  " + row for row in rows(gap, mark)]
    check(read(tmp_path, "\n".join(["% made by hand", header, *lines])))


def test_columns_of_savetxt(tmp_path: Path) -> None:
    """What NumPy writes without being asked for more, a gap as nan."""
    P = P_MMHG.copy()
    P[7] = np.nan
    np.savetxt(tmp_path / "s.txt", np.column_stack([TIME, P, R_MM]), header="time[s] AA.P[mmHg] AA.R[mm]")
    record = read_record(tmp_path / "s.txt")
    assert np.isnan(record.channels["AA.P"][7]) and np.isnan(record.channels["AA.P"]).sum() == 1
    np.testing.assert_array_equal(record.channels["AA.R"], R_MM * 1e-3)


# --- what may mean two things -------------------------------------------------------------------------------------


def test_a_comma_that_may_group_thousands_is_asked(tmp_path: Path) -> None:
    """Whole milliseconds and "85,123": asked; read as either with --decimal."""
    lines = [f"{i};{80 + i % 7},{100 + i}" for i in range(40)]
    content = "\n".join(["t (ms);AA.P [Pa]", *lines])
    said = refused(tmp_path, content)
    assert "line 2: '80,100' may be 80.100 or 80100; say which: --decimal comma" in said
    assert read(tmp_path, content, decimal="comma").channels["AA.P"][1] == 81.101
    assert read(tmp_path, content, decimal="point").channels["AA.P"][1] == 81101.0
    assert "--decimal = 'dot': must be comma or point" in str(
        pytest.raises(ValueError, read, tmp_path, content, decimal="dot").value
    )


@pytest.mark.parametrize("blank", ["\u00a0", "\u202f"])
def test_fixed_blanks_group_thousands(tmp_path: Path, blank: str) -> None:
    """As a French spreadsheet writes them, in the first sample, too."""
    P = [f"{p * MMHG:,.4f}".replace(",", blank).replace(".", ",") for p in P_MMHG]
    lines = [f"{t:.3f};{p};{r:.8f}".replace(".", ",") for t, p, r in zip(TIME, P, R_MM, strict=True)]
    check(read(tmp_path, "\n".join(["Temps [s];AA.P [Pa];AA.R [mm]", *lines])))


@pytest.mark.parametrize(
    ("cell", "advice"),
    [
        ("1.014,5", "if its point groups thousands, say --decimal comma"),
        ("1 014,5", "export it without separators of thousands"),
        ("0.014", "the decimal mark is a comma elsewhere: write it alike everywhere"),
    ],
)
def test_grouped_digits_are_refused_with_what_helps(tmp_path: Path, cell: str, advice: str) -> None:
    """Points and blanks between digits, beyond the lines that decide."""
    lines = rows(";", ",")
    lines[900] = f"{lines[900].partition(';')[0]};{cell};9,0"
    assert advice in refused(tmp_path, "\n".join(["time [s];AA.P [mmHg];AA.R [mm]", *lines]))


def test_marks_that_change_are_refused_where_they_do(tmp_path: Path) -> None:
    """A point among decimal commas, beyond the lines that decide: line and column."""
    lines = rows(";", ",")
    lines[900] = lines[900].replace(",", ".")
    said = refused(tmp_path, "\n".join(["time [s];AA.P [mmHg];AA.R [mm]", *lines]))
    assert "line 902, column 'time [s]': '4.50000000' is not a number; the decimal mark is a comma elsewhere" in said


# --- which column is what -----------------------------------------------------------------------------------------

LAB = {"Time": TIME, "ECG": 0.0 * TIME, "Pressure (mmHg)": P_MMHG, "Radius": R_MM}


def test_map(tmp_path: Path) -> None:
    """Names as in the file; the unit from the title or from the option; what is not named is left out."""
    names = Reading.from_options(["Time=time [s]", "Pressure (mmHg)=AA.P", "Radius=AA.R [mm]"], None).names
    check(read(tmp_path, text(LAB), names=names))


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (
            {},
            "'ECG', 'Pressure (mmHg)', 'Radius' are no channels; allowed are <site>.P, <site>.Q, <site>.R or <site>.D "
            "(a diameter), with any name of a site, and inlet.Q, the flow into the arteries; say which is which, such "
            "as "
            '--map "ECG=" --map "Pressure (mmHg)=Ao.P" --map "Radius=Ao.R [mm]"',
        ),
        ({"Pressure": "AA.P"}, "column 'Time': it has no unit; say which: --map \"Time=time [s]\""),
        (
            {"Time": "time [s]", "Radius": "AA.R"},
            "column 'Radius': it has no unit; say which: --map \"Radius=AA.R [mm]\"",
        ),
        ({"Flow": "AA.Q"}, "--map \"Flow=AA.Q\": no column has this title or number; the columns are 'Time', 'ECG'"),
        ({"Time": "time [s]", "Radius": "AA.X"}, "'AA.X' is no variable of a network; allowed are <site>.P"),
        ({"Time": "time [s]"}, '--map "Pressure (mmHg)=Ao.P" --map'),
    ],
)
def test_what_a_map_lacks(tmp_path: Path, names: dict[str, str], expected: str) -> None:
    """One sentence with the option that helps."""
    assert expected in refused(tmp_path, text(LAB), names=names)


def test_map_that_is_none() -> None:
    """Neither title nor variable: the sentence has an example."""
    for pair in ("Pressure", "=AA.P"):
        with pytest.raises(ValueError, match="must be TITLE=VARIABLE, such as"):
            Reading.from_options([pair], None)


@pytest.mark.parametrize("above", ["", "# loop\n\n"])
@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_columns_by_number(tmp_path: Path, separator: str, above: str) -> None:
    """No line names the columns: asked with the first row and an example, then read by number; titled ones, too."""
    content = above + "\n".join(rows(separator, "."))
    said = refused(tmp_path, content)
    assert (
        f"it has no header, and its first row is 0, {P_MMHG[0]:g}, {R_MM[0]:g}; say which column is which, such as "
        in said
    )
    assert said.endswith('--map "1=time [s]" --map "2=inlet.Q [mL/s]" --map "3=AA.P [mmHg]".')
    names = {"1": "time [s]", "2": "AA.P [mmHg]", "3": "AA.R [mm]"}
    check(read(tmp_path, content, names=names))
    check(read(tmp_path, separator.join(["a", "b", "c"]) + "\n" + "\n".join(rows(separator, ".")), names=names))
    assert '"4=AA.Q": no column has this title or number' in refused(tmp_path, content, names={**names, "4": "AA.Q"})
    assert '"1=time [s]"' in refused(tmp_path, content, names={**names, "1": "time"})


@pytest.mark.parametrize("respired", [0.0, 0.1])
def test_a_mock_loop_is_cut_into_beats(tmp_path: Path, respired: float) -> None:
    """As a mock circulation writes it: no header, 1 kHz, steps of 0.1 mL/s and 0.1 mmHg, beats of 0.8 s, strokes that
    swing by 10 % with 12 breaths a minute or not: all whole beats, the period to 1e-4."""
    time = np.arange(24_000) * 1e-3
    phase = 2.0 * np.pi * time / 0.8
    swing = 1.0 + respired * np.sin(2.0 * np.pi * 0.2 * time)
    Q = swing * 70.0 * (1.0 + np.sin(phase) + 0.3 * np.sin(2.0 * phase))
    P = 80.0 + swing * (20.0 * np.sin(phase - 0.5) + 8.0 * np.sin(2.0 * phase - 1.0))
    noise = np.random.default_rng(0).normal(0.0, 0.05, len(time))
    table = zip(time, Q, P, P + noise, strict=True)
    lines = [f"{t:g},{q:.1f},{p:.1f},{r:.1f}" for t, q, p, r in table]
    names = {"1": "time [s]", "2": "inlet.Q [mL/s]", "3": "C.P [mmHg]", "4": "R.P [mmHg]"}
    beats = align(read(tmp_path, "\n".join(lines), names=names))
    assert beats.T == pytest.approx(0.8, rel=1e-4)
    assert beats.n_beats == (30 if beats.variable is None else 28)  # varying ones begin at the end of diastole
    assert set(beats.values) == {"inlet.Q", "C.P", "R.P"} and not beats.told.get("sampling")


# --- other kinds of file ------------------------------------------------------------------------------------------


def test_matlab(tmp_path: Path) -> None:
    """Vectors, columns of a matrix, a struct; a scalar is none, a vector of another length is left out."""
    path = tmp_path / "record.mat"
    names = {"t": "time [s]", "AA.P": "AA.P [mmHg]"}
    savemat(path, {"t": TIME, "fs": 200.0, "odd": np.arange(3.0), "AA": {"P": P_MMHG, "R_mm": R_MM}})
    check(read_record(path, Reading(names={"t": "time [s]", "AA.P": "AA.P [mmHg]", "AA.R_mm": "AA.R"})))
    savemat(path, {"data": np.column_stack([TIME, P_MMHG, R_MM])})
    names = {"data(:,1)": "time [s]", "data(:,2)": "AA.P [mmHg]", "data(:,3)": "AA.R [mm]"}
    check(read_record(path, Reading(names=names)))


def test_edf(tmp_path: Path) -> None:
    """Signals of 16 bits over their range: to a step of the converter; the time from the rate."""
    pyedflib = pytest.importorskip("pyedflib")
    path = tmp_path / "record.edf"
    with pyedflib.EdfWriter(str(path), 2) as writer:
        for i, (label, unit, values) in enumerate([("P", "mmHg", P_MMHG), ("D", "mm", R_MM)]):
            low, high = np.floor(values.min()), np.ceil(values.max())
            writer.setSignalHeader(i, {"label": label, "dimension": unit, "sample_frequency": 200,
                                       "physical_min": low, "physical_max": high, "digital_min": -32768,
                                       "digital_max": 32767, "transducer": "", "prefilter": ""})  # fmt: skip
        writer.writeSamples([P_MMHG, R_MM])
    check(read_record(path, Reading(names={"P": "AA.P", "D": "AA.R"})), 1e-5)


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.xlsx", b"PK\x03\x04", "an Excel workbook, which is not read; save the sheet as CSV"),
        ("a.mat", b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + b"\x89HDF", "save it with save(…, '-v7')"),
        ("a.mat", b"MATLAB 5.0", "not a whole MATLAB file"),
        ("a.hea", b"a 2 250", "rdsamp -r NAME -c"),
        ("a.bin", bytes(40), "not text (byte 0 is zero)"),
        ("a.csv", b"\x1f\x8b", "a compressed file"),
        (
            "a.csv",
            b"time [s];AA.P [mmHg]\n00:01;80\n",
            "'00:01' is not a number; write a time as hours:minutes:seconds",
        ),
    ],
)
def test_what_is_not_read(tmp_path: Path, name: str, content: bytes, expected: str) -> None:
    """What was found, and what to do."""
    assert expected in refused(tmp_path, content, name)


# --- commands -----------------------------------------------------------------------------------------------------


def test_columns(tmp_path: Path) -> None:
    """A look at the columns needs nothing but the file, wherever the option stands; exit code 0; JSON, too."""
    path = tmp_path / "lab.csv"
    path.write_text(text(LAB))
    runner = CliRunner(env={"COLUMNS": "200"})
    for command in ("fit", "calibrate", "discover"):
        done = runner.invoke(app, [command, str(path), "--columns", "--map", "Pressure (mmHg)=AA.P"])
        assert done.exit_code == 0 and "AA.P, a pressure" in done.stdout and "left out" in done.stdout
    found = json.loads(runner.invoke(app, ["fit", str(path), "--columns", "--json"]).stdout)
    assert found["samples"] == len(TIME)
    pressure = found["columns"][2]
    assert (pressure["title"], pressure["unit"], pressure["min"]) == ("Pressure (mmHg)", "mmHg", round(P_MMHG.min(), 9))
    assert '--map "Pressure (mmHg)=Ao.P"' in pressure["read_as"]


def test_times_of_a_clock_are_told_apart(tmp_path: Path) -> None:
    """Seconds since midnight at 1 kHz: nine digits where five would be the same number three times."""
    content = "\n".join(["clock,AA.P [mmHg]", *(f"23:59:57.{k:03d},{85 + k % 7}" for k in range(40))])
    (tmp_path / "lab.csv").write_text(content)
    runner = CliRunner(env={"COLUMNS": "200"})
    assert (
        "86397 86397.001 86397.002" in runner.invoke(app, ["discover", str(tmp_path / "lab.csv"), "--columns"]).stdout
    )


def test_columns_are_asked_for_in_full(tmp_path: Path) -> None:
    """At 80 columns, too, the option to copy stands in one line, for it is below the table."""
    (tmp_path / "lab.csv").write_text(text({"time [s]": TIME, "Carotid artery catheter": P_MMHG, "AA.P": P_MMHG}))
    runner = CliRunner(env={"COLUMNS": "80"})
    said = runner.invoke(app, ["discover", str(tmp_path / "lab.csv"), "--columns"]).stdout.splitlines()
    for option in ('--map "Carotid artery catheter=AA.P [mmHg]"', '--map "AA.P=AA.P [mmHg]"'):
        assert sum(option in line for line in said) == 1
    assert sum("see below" in line for line in said) == 2 and "…" not in "".join(said)


def test_columns_without_known_titles_are_asked_for_with_sites_of_their_own(tmp_path: Path) -> None:
    """Two pressures under foreign titles are two sites; a file without titles gets one line with all options."""
    runner, path = CliRunner(env={"COLUMNS": "200"}), tmp_path / "lab.csv"

    def asked(content: str) -> list[str]:
        path.write_text(content)
        said = runner.invoke(app, ["discover", str(path), "--columns"]).stdout.splitlines()
        return [line for line in said if "--map" in line]

    flow = 50.0 + P_MMHG
    titled = {"time [s]": TIME, "Flow (mL/s)": flow, "ABP (mmHg)": P_MMHG, "Radial (mmHg)": P_MMHG}
    options = ("Flow (mL/s)=inlet.Q", "ABP (mmHg)=Ao.P", "Radial (mmHg)=site2.P")
    for line, option in zip(asked(text(titled)), options, strict=True):
        assert f'say what it is, such as --map "{option}"' in line
    untitled = "\n".join(text(titled).splitlines()[1:])
    options = ("1=time [s]", "2=inlet.Q [mL/s]", "3=AA.P [mmHg]", "4=FA.P [mmHg]")
    said = " ".join(f'--map "{each}"' for each in options)
    assert asked(untitled) == [f"The file has no header; say which column is which, such as {said}."]


@pytest.mark.parametrize(
    ("title", "advice"),
    [
        ("Diameter", '--map "Diameter=AA.D [mm]"'),
        ("Diameter (mm)", '--map "Diameter (mm)=AA.D"'),
        ("Vessel radius", '--map "Vessel radius=AA.R [mm]"'),
        ("Aortic flow", '--map "Aortic flow=inlet.Q [mL/s]"'),
        ("Flow (L/min)", '--map "Flow (L/min)=inlet.Q"'),
        ("Q [m3/s]", '--map "Q [m3/s]=inlet.Q"'),
        ("AoF", '--map "AoF=inlet.Q [mL/s]"'),
        ("AoP [V]", '--map "AoP [V]=AA.P [mmHg]"'),
        ("Left carotid pressure", '--map "Left carotid pressure=AA.P [mmHg]"'),
        ("channel 3", 'if it is a pressure, say so with --map "channel 3=AA.P [mmHg]"'),
    ],
)
def test_the_option_that_is_proposed_fits_the_column(tmp_path: Path, title: str, advice: str) -> None:
    """By the unit of the title, or else its words: no mmHg for a diameter."""
    assert advice in refused(tmp_path, text({"time [s]": TIME, title: R_MM}))


@pytest.mark.parametrize(
    ("title", "why"),
    [
        ("ECG", "if it is none of them"),
        ("Lead II [mV]", "mV is a unit of none"),
        ("LVP (mmHg)", "if it is none of them"),
        ("dP/dt (mmHg/s)", "if it is none of them"),
        ("HR (bpm)", "if it is none of them"),
        ("Cardiac output (L/min)", "if it is none of them"),
    ],
)
def test_a_column_of_something_else_is_left_out(tmp_path: Path, title: str, why: str) -> None:
    """An ECG, a ventricle, a number that is derived, a unit that no channel has: only to leave it out is proposed."""
    said = refused(tmp_path, text({"time [s]": TIME, title: R_MM}))
    assert why in said and f'leave it out with --map "{title}="' in said and said.count("--map") == 1


def test_discover_writes_no_page_of_a_file_that_it_cannot_read(tmp_path: Path) -> None:
    """Text in place of numbers, or a column without unit: exit code 2, one sentence, no folder."""
    out = tmp_path / "out"
    for content in ("time [s],AA.P [mmHg]\n0,x\n", text({"time [s]": TIME, "AA.P": P_MMHG})):
        (tmp_path / "r.csv").write_text(content)
        words = ["discover", str(tmp_path / "r.csv"), "--model", "sheep", "--out", str(out)]
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 2 and done.stderr.count("Error: ") == 1 and not out.exists(), done.output


def test_fit_takes_the_options(tmp_path: Path) -> None:
    """The wall of a file with its own names is that of the plain one, digit for digit."""
    late = np.roll(R_MM, 2)  # behind the pressure, as that of a viscous wall
    (tmp_path / "plain.csv").write_text(text(bench(R=late)))
    (tmp_path / "lab.csv").write_text(
        text({"t_s": TIME, "p (mmHg)": P_MMHG, "r": late}).replace(",", ";").replace(".", ",")
    )
    asked = ["--site", "AA", "--h", "1 mm", "--model", "linear", "--bootstrap", "0", "--json", "--quiet"]
    maps = ["--map", "p=AA.P", "--map", "r=AA.R [mm]"]
    runner = CliRunner()
    sets = [json.loads(runner.invoke(app, ["fit", str(tmp_path / name), *asked, *more]).stdout)
            for name, more in (("plain.csv", []), ("lab.csv", maps))]  # fmt: skip
    assert sets[0]["values"] == sets[1]["values"]
    assert "columns" not in sets[0]["provenance"]
    assert sets[1]["provenance"]["columns"] == {"map": {"p": "AA.P", "r": "AA.R [mm]"}}
