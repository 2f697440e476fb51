"""Logs as other tools write them: each is read right, or refused with place and remedy."""

import io
from datetime import datetime, timedelta

import numpy as np
import pytest
from flyer_cases import JOINT, columns, csv_of, flyer, rows_of, write

from cpid_drake import InputError, read_log
from cpid_drake.identification.checked_log import check_log
from cpid_drake.logs.formats import inspect_log, read_table

ALL = ("attitude", "gyro", "position", "velocity", "encoders", "joint_rates")


def body(between=",", end="\n", cell=lambda k, text: text, extra=""):
    """Return the lines of numbers, each cell changed."""
    rows = rows_of(columns())[1:]
    lines = (between.join(cell(k, text) for k, text in enumerate(row)) for row in rows)
    return "".join(line + extra + end for line in lines)


def head(between=",", end="\n", name=lambda text: text):
    return between.join(name(each) for each in columns()) + end


def stamped(form, start=datetime(2026, 1, 1, 23, 59, 55), ending=""):
    """Return the log with the time of day in a form of strftime, cut to milliseconds."""

    def cell(k, text):
        if k:
            return text
        return (start + timedelta(seconds=float(text))).strftime(form)[:-3] + ending

    return head() + body(cell=cell)


def lasting(form):
    """Return the log with its times as text of durations."""
    times = [f"{time:.2f}" for time in columns()["time"]]
    rows = body().splitlines()
    return head() + "".join(
        form(time) + row[row.index(",") :] + "\n" for time, row in zip(times, rows)
    )


def units(*names):
    """Return a row of units of the groups time, attitude, rate, position, joints."""
    counts = (1, 4, 3, 3, 4)
    return ",".join(name for name, count in zip(names, counts) for _ in range(count)) + "\n"


SI = units("s", "-", "rad/s", "m", "rad")
ISO = "%Y-%m-%dT%H:%M:%S.%f"

READ = {
    "commented header, as of numpy.savetxt": "# " + head() + body(),
    "comments above a commented header": "# Arm test 7\n#\n# " + head() + body(),
    "blanks after commas, quoted names": head(", ", name='"{}"'.format) + body(", "),
    "quoted numbers": head() + body(cell=lambda k, text: f'"{text}"'),
    "blanks around tabs": head(" \t ") + body(" \t "),
    "columns of blanks": head("   ") + body("  "),
    "semicolons with points": head(";") + body(";"),
    "semicolons and decimal commas": head(";") + body(";").replace(".", ","),
    "tabs and decimal commas": head("\t") + body("\t").replace(".", ","),
    "a spreadsheet's note on the separator": "sep=;\n" + head(";") + body(";"),
    "trailing commas in rows": head() + body(extra=","),
    "trailing commas everywhere": head(end=",,\n") + body(extra=",,"),
    "carriage returns only": head(end="\r") + body(end="\r"),
    "Windows and a byte order mark": "\ufeff" + head(end="\r\n") + body(end="\r\n"),
    "columns in another order": "".join(
        ",".join(reversed(line.split(","))) + "\n" for line in (head() + body()).splitlines()
    ),
    "lines of blanks between": head() + "  \n" + body(end="\n \n"),
    "an index without a name": ","
    + head()
    + "".join(f"{k},{line}\n" for k, line in enumerate(body().splitlines())),
    "units": head() + SI + body(),
    "units in brackets, none of ratios": head()
    + units("[s]", "", "[rad/s]", "[m]", "(rad)")
    + body(),
    "stamps of ISO 8601": stamped(ISO),
    "stamps in UTC": stamped(ISO, ending="Z"),
    "stamps with a zone, a blank between": stamped("%Y-%m-%d %H:%M:%S.%f", ending="+02:00"),
    "times of day over midnight": stamped("%H:%M:%S.%f"),
    "times of day, semicolons": stamped("%H:%M:%S.%f").replace(",", ";"),
    "durations in seconds, as MATLAB's timetables have them": lasting("{} sec".format),
    "durations in minutes": lasting(lambda text: f"{float(text) / 60!r} min"),
    "durations in hours, minutes and seconds": lasting(lambda text: f"00:00:{float(text):06.3f}"),
    "durations with days, as of pandas": lasting(lambda text: f"0 days 00:00:{float(text):012.9f}"),
    "UTF-16 with the lower byte first": ("\ufeff" + head() + body()).encode("utf-16-le"),
    "UTF-16 with the higher byte first": ("\ufeff" + head() + body(end="\r\n")).encode("utf-16-be"),
    "a name in a code page of Windows": (head(end=",Gier [°]\n") + body(extra=",0")).encode(
        "cp1252"
    ),
    "a comment in a code page of Windows": ("# Prüfstand\n# " + head() + body()).encode("cp1252"),
}


@pytest.mark.parametrize("name", READ)
def test_what_is_plain_is_read(tmp_path, name):
    found, expected = inspect_log(write(tmp_path, READ[name])), columns()
    assert found.problems == []
    log = found.log
    for sensor, names in (("position", ("x", "y", "z")), ("gyro", ("bwx", "bwy", "bwz"))):
        np.testing.assert_allclose(log[sensor].time, expected["time"], atol=1e-9)
        np.testing.assert_array_equal(log[sensor].value.T, [expected[each] for each in names])
    assert sorted(log.joint_names) == sorted(flyer().joint_names)
    joint = log.joint_names.index(JOINT.removeprefix("q:"))
    np.testing.assert_array_equal(log.encoders.value[:, joint], expected[JOINT])


def test_a_unit_in_a_code_page_of_windows_is_read(tmp_path):
    """Joints in degrees are refused by their unit, as in UTF-8, until a map names it."""
    named = head() + units("s", "-", "rad/s", "m", "°")
    wide, narrow = (
        refusal_of(write(tmp_path, (named + body()).encode(code))) for code in ("utf-8", "cp1252")
    )
    assert wide == narrow
    assert "states its unit" in wide


def refusal_of(path):
    with pytest.raises(InputError) as caught:
        inspect_log(path)
    return str(caught.value)


@pytest.mark.parametrize("code", ["utf-16", "cp1252"])
def test_a_problem_keeps_its_line_in_any_encoding(tmp_path, code):
    content = "# 20 °C\n" + with_cell(7, "x", "oops") + "\n\n1,2\n"
    found = inspect_log(write(tmp_path, content.encode(code)))
    cell, row = found.problems
    assert cell.startswith("line 8, column 'x': 'oops'")
    assert row.startswith("line 256: 2 cells")


def test_long_durations_are_not_counted_from_the_first(tmp_path):
    rows = lasting(lambda text: f"25:00:{float(text):06.3f}")
    time = read_log(write(tmp_path, rows)).gyro.time
    np.testing.assert_allclose(time, 90_000 + columns()["time"], atol=1e-9)


@pytest.mark.parametrize("text", ["", "NaN", "nan", "NA"])
def test_a_cell_without_a_number_is_an_absent_sample(tmp_path, text):
    found = inspect_log(write(tmp_path, with_cell(7, "x", text)))
    assert found.problems == []
    time = columns()["time"]
    np.testing.assert_allclose(found.log.position.time, np.delete(time, 5), atol=1e-9)
    np.testing.assert_allclose(found.log.gyro.time, time, atol=1e-9)


def parquet_of(time):
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    stream = io.BytesIO()
    parquet.write_table(pyarrow.table(columns() | {"time": time}), stream)
    return stream.getvalue()


def single(start):
    return (start + columns()["time"]).astype(np.float32)


TIMES = np.datetime64("2026-01-01T00:00:00", "ns") + (columns()["time"] * 1e9).astype(int)


def test_stamps_of_parquet_are_read(tmp_path):
    """They hold nanoseconds."""
    log = inspect_log(write(tmp_path, parquet_of(TIMES), "log.parquet")).log
    np.testing.assert_allclose(log.gyro.time, columns()["time"], atol=1e-8)


MOTIVE = """Format Version,1.23,Take Name,take1,Rotation Type,Quaternion,Length Units,{}

,Type{}
,Name{}
,ID{}
,{}
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z
"""


def motive(unit, scale=1.0, shift=""):
    """Return Motive's export; `shift` are the commas that some versions have in front."""
    kinds = ",Rotation" * 4 + ",Position" * 3
    top = MOTIVE.format(unit, *(7 * f",{each}" for each in ("Rigid Body", "body", "1")), kinds)
    top = "\n".join(shift * line.startswith(",") + line for line in top.splitlines())
    given = columns()
    names = ("qx", "qy", "qz", "qw", "x", "y", "z")
    rows = np.column_stack([given["time"], *(given[name] for name in names)])
    rows[:, 5:] *= scale
    lines = (f"{k}," + ",".join(map(repr, row)) for k, row in enumerate(rows.tolist()))
    return top + "\n" + "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("unit", "short", "scale", "shift"), [("Meters", "m", 1, ","), ("Millimeters", "mm", 1e3, "")]
)
def test_exports_of_motive_are_read_with_their_units(tmp_path, shift, unit, short, scale):
    path = write(tmp_path, motive(unit, scale, shift))
    table, given = read_table(path), columns()
    assert table.header == "line 7"
    np.testing.assert_array_equal(table.columns["Time (Seconds)"], given["time"])
    np.testing.assert_array_equal(table.columns["body:Rotation W"], given["qw"])
    np.testing.assert_allclose(table.columns[f"body:Position Y [{short}]"], scale * given["y"])
    with pytest.raises(InputError, match=r"line 7: there is no column 'time'.*`cpid log map`"):
        inspect_log(path)


def with_cell(line, column, text):
    rows = rows_of(columns())
    rows[line - 1][rows[0].index(column)] = text
    return "".join(",".join(row) + "\n" for row in rows)


DEGREES = head() + units("s", "-", "rad/s", "m", "deg") + body()

REFUSED = {
    "two logs with headers": (
        head() + body() + head() + body(),
        "line 253 repeats the header.*cut",
    ),
    "two logs without": (
        head() + body() + body(),
        "line 253, .*starts again at 0 s .*251 rows.*Cut",
    ),
    "joints in degrees by their units": (
        DEGREES,
        r"'q:arm_joint1 \[deg\]' states its unit.*log map",
    ),
    "positions in mm by their units": (
        head() + units("s", "-", "rad/s", "mm", "rad") + body(),
        r"'x \[mm\]' states its unit: a map of columns must name it",
    ),
    "a unit in the header": (
        head(name=lambda n: "x [mm]" if n == "x" else n) + body(),
        r"'x \[mm\]'",
    ),
    "units that are none": (
        head() + units("s", "-", "apples", "m", "rad") + body(),
        "line 2: 'apples'",
    ),
    "two lines of names": (
        units("t", "pose", "imu", "pose", "arm") + head() + body(),
        "one line of",
    ),
    "a commented header of MATLAB": ("%" + head() + body(), "did you mean '%time'"),
    "stamps of which some have a zone": (
        stamped(ISO, ending="Z").replace("Z", "", 7),
        "line 2, column 'time': '2026-01-01T23:59:55.000'",
    ),
    "stamps of a day that is none": (stamped(ISO).replace("-01-01", "-02-30"), "ISO 8601"),
    "stamps with the month first": (stamped("%m/%d/%Y %H:%M:%S.%f"), "line 2, .*ISO 8601"),
    "no stamp in a row": (with_cell(9, "time", ""), "line 9, column 'time': the time is absent"),
    "commas of decimals or of thousands": (
        head(";") + body(";", cell=lambda k, text: f"{float(text):.3f}".replace(".", ",")),
        "line 2, .*with a decimal point",
    ),
    "commas and points": (
        head(";") + body(";", cell=lambda k, text: text.replace(".", ",") if k else text),
        "line 2, .*with a decimal point",
    ),
    "a quaternion that nobody filled": (with_cell(7, "qw", "0"), "line 7: the quaternion's norm"),
    "a damaged message": (with_cell(7, "x", "1e20"), "line 7, column 'x': 1e.20 is implausible"),
    "no header": (body(), "the first line must hold the columns' names"),
    "UTF-16 that is cut": (
        (head() + body()).encode("utf-16")[:-5],
        "line 252 is damaged: it is not text in UTF-16",
    ),
    "a damaged byte in a row": (
        (head() + body()).encode().replace(b"\n0.04,", b"\n0.04,\xb0"),
        "line 3 is not text in UTF-8.*save it in that encoding",
    ),
    "a duration without a unit that is known": (
        lasting("{} fortnights".format),
        "line 2, column 'time': '0.00 fortnights'",
    ),
    "Motive's Euler angles": (motive("Meters").replace("Quaternion", "XYZ"), "type Quaternion"),
    "Motive's header cut": (motive("Meters").replace(",Name", ",Nom"), "header of Motive's export"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_plain_is_refused_with_place_and_remedy(tmp_path, name):
    content, phrase = REFUSED[name]
    with pytest.raises(InputError, match=phrase):
        read_log(write(tmp_path, content))


def test_a_second_log_is_one_problem(tmp_path):
    found = inspect_log(write(tmp_path, head() + body() + body()))
    assert len(found.problems) == 1
    np.testing.assert_array_equal(found.log.gyro.time, columns()["time"])


@pytest.mark.parametrize(("start", "kind"), [(1_767_225_600.0, "csv"), (400_000.0, "parquet")])
def test_stamps_of_single_precision_are_named(tmp_path, start, kind):
    given = columns() | {"time": single(start).astype(float)}
    content = csv_of(given) if kind == "csv" else parquet_of(single(start))
    with pytest.raises(InputError, match=r"'time' are rounded to single precision.*float64"):
        inspect_log(write(tmp_path, content, f"log.{kind}"))


@pytest.mark.parametrize("time", [np.arange(251) / 32, 4.0 * np.arange(251) + 1e6])
def test_even_stamps_are_no_single_precision(tmp_path, time):
    inspect_log(write(tmp_path, csv_of(columns() | {"time": time})))


# -- what is left out, and told ------------------------------------------------------------------


def turned(given, low):
    given[JOINT] = (given[JOINT] - low) % (2 * np.pi) + low


def homed(given):
    given[JOINT][100:] += 2 * np.pi


def one_axis(given):
    given["bwx"][:] = given["bwy"][:] = 0.0


def offset(given):
    given["bwx"][:], given["bwy"][:], given["bwz"][:] = 0.01, -0.02, 0.0


def one_rate(given):
    given["qd:arm_joint2"][:] = 0.0


def no_rate(given):
    given["qd:arm_joint2"][:] = np.nan


def no_pose(given):
    for name in "xyz":
        given[name][:] = 0.0


def held(given):
    for name in ("qw", "qx", "qy", "qz"):
        given[name] = given[name][::5].repeat(5)[:251]


def own_rows(given):
    for k, joint in enumerate(flyer().joint_names):
        given[f"q:{joint}"][np.arange(251) % 4 != k] = np.nan
        given.pop(f"qd:{joint}", None)


def gripper(given):
    given["q:gripper"] = np.linspace(0.0, 0.08, 251)
    given["qd:gripper"] = np.full(251, 0.008)


def saturated(given):
    given["bwy"] = np.clip(given["bwy"], -0.4, np.inf)


LEFT = {
    "an angle of 0 to 360°": (lambda given: turned(given, 0.0), ALL, "", ""),
    "an angle that is wrapped where it starts": (
        lambda g: turned(g, 2.5),
        ALL,
        "encoders",
        "unwrapped",
    ),
    "an angle that a homing sets": (homed, ALL, "encoders", "unwrapped: arm_joint1 (1 jump)"),
    "a gyro of one axis": (one_axis, ALL, "gyro", "zero in x, y while the attitude changed"),
    "a gyro that stands still": (offset, ALL, "gyro", "constant in x, y, z while the attitude"),
    "a gyro that stands still, alone": (
        offset,
        ("gyro", "encoders"),
        "gyro",
        "constant while arm_joint1, ",
    ),
    "one rate that is not filled": (one_rate, ALL, "joint_rates", "zero in arm_joint2 while"),
    "one rate that is empty": (no_rate, ALL, "joint_rates", "those of arm_joint2 are not filled"),
    "no pose": (no_pose, ALL[:3] + ALL[4:], "position", "constant while arm_joint1, "),
    "an attitude in rows of the gyro": (held, ALL, "attitude", "repeats each value over 5 rows"),
    "joints in rows of their own": (own_rows, ALL[:5], "encoders", "rows of their own"),
    "wrapped joints in rows of their own": (
        lambda given: (turned(given, -np.pi), own_rows(given)),
        ALL[:5],
        "encoders",
        "rows of their own",
    ),
    "a gripper that moves": (gripper, ALL, "encoders", "as if they were fixed: gripper by 0.08"),
    "a gyro at its end": (saturated, ALL, "gyro", "at the end of the scale (-0.4), left out"),
}


@pytest.mark.parametrize("name", LEFT)
def test_what_is_not_measured_is_told_and_does_no_harm(tmp_path, name):
    """What remains agrees with what was logged, and no convention is doubted."""
    change, groups, sensor, phrase = LEFT[name]
    given = columns(*groups)
    change(given)
    found = inspect_log(write(tmp_path, csv_of(given)), joints=flyer().joint_names)
    assert found.problems == []
    log = check_log(flyer(), found.log)
    told = {each.name: "; ".join(each.notes) for each in log.channels if each.notes}
    assert {*told} == {sensor} - {""}
    assert phrase in told.get(sensor, "")
    assert log.failures == ()
    assert not any("differ by" in warning for warning in log.warnings)
    true, kept = columns(*groups), log.measurements
    if len(kept.position):
        np.testing.assert_array_equal(kept.position.value[:, 0], true["x"])
    q = np.interp(kept.encoders.time, true["time"], true[JOINT])
    turns = (kept.encoders.value[:, 0] - q) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns[0]), atol=1e-3)
