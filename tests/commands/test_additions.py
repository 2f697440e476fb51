"""An estimator, a row family and a format of logs, each added by one record, serve all commands."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flyer_cases import SAMPLE

from cpid_drake import read_log, write_log
from cpid_drake.dynamics.rows import RELATIVE_ROWS, ROW_FAMILIES, STANDARD_ROWS
from cpid_drake.identification import by_rows
from cpid_drake.identification.estimators import ESTIMATORS, Estimator
from cpid_drake.logs.formats import FORMATS
from cpid_drake.logs.table import LogTable

CRAFT = ("--spacecraft", "free_flyer_payload")


def estimate_every_second(known, logs, progress):
    """Least squares on every second sample: an estimator that somebody might try."""
    [log] = logs.values()
    names = ("attitude", "gyro", "position", "velocity", "encoders", "joint_rates")
    whole = log.measurements
    half = whole.updated({n: whole[n].where(slice(None, None, 2)) for n in names})
    rows = replace(known, rows=RELATIVE_ROWS.name)
    found = by_rows.estimate(rows, {"": replace(log, measurements=half)})
    return replace(found, estimator="every_second", rows=None)


def read_json(file, where):
    content = json.loads(file.read_text())
    return LogTable({name: np.array(column, dtype=float) for name, column in content.items()})


def write_json(path, columns, values):
    content = {name: column.tolist() for name, column in zip(columns, values.T, strict=True)}
    path.write_text(json.dumps(content))


@pytest.fixture(autouse=True)
def added(cpid, monkeypatch):
    every_second = Estimator("every_second", "every second", "tests", estimate_every_second)
    monkeypatch.setitem(ESTIMATORS, "every_second", every_second)
    grams = replace(STANDARD_ROWS, name="grams", momentum_columns=None)
    monkeypatch.setitem(ROW_FAMILIES, "grams", grams)
    monkeypatch.setitem(FORMATS, ".json", (read_json, write_json))
    write_log("log.json", read_log(SAMPLE))


def identified(cpid, log, *options):
    code, *_ = cpid("identify", log, *CRAFT, *options, "--json", "found.txt", "--force")
    assert code == 4  # noise biases rows of this log
    return json.loads(Path("found.txt").read_text())


def test_an_added_estimator_identifies(cpid):
    found = identified(cpid, SAMPLE, "--estimator", "every_second")
    assert found["parameters"] != identified(cpid, SAMPLE, "--rows", "relative")["parameters"]
    assert found["parameters"][0] == pytest.approx(8.5, rel=0.05)
    assert found["estimator"] == "every_second"


def test_a_log_in_an_added_format_is_read(cpid):
    options = ("--estimator", "least_squares")
    one, other = (identified(cpid, log, *options) for log in (SAMPLE, "log.json"))
    assert one["parameters"] == other["parameters"]
    assert "no problems found" in cpid("log", "check", "log.json", *CRAFT)[1]


def test_messages_name_what_is_added(refusal):
    message = refusal("identify", SAMPLE, "--rows", "grams", "--momentum", "unknown", *CRAFT)
    assert "cannot estimate an unknown" in message
