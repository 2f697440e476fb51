"""A file format added from outside, by a record in the registry, serves all commands on logs."""

import json
from pathlib import Path

import numpy as np
import pytest

from cpid_drake import read_telemetry, write_telemetry
from cpid_drake.errors import InputError
from cpid_drake.logs.files import FORMATS, Format
from cpid_drake.logs.table import Table
from cpid_drake.resources import models_directory

SAMPLE = models_directory() / "telemetry/free_flyer.csv"
FREE_FLYER = (
    *("--spacecraft", models_directory() / "free_flyer/free_flyer.urdf"),
    *("--base", "body", "--capture-frame", "capture_point"),
)


def read_json(file, where):
    content = json.loads(file.read_text())
    return Table({name: np.array(column, dtype=float) for name, column in content.items()})


def write_json(path, columns, values):
    content = {name: column.tolist() for name, column in zip(columns, values.T, strict=True)}
    path.write_text(json.dumps(content))


@pytest.fixture
def added(monkeypatch, tmp_path):
    monkeypatch.setattr(f"{FORMATS_MODULE}.FORMATS", [*FORMATS, JSON])
    monkeypatch.chdir(tmp_path)
    write_telemetry("log.json", read_telemetry(SAMPLE))


FORMATS_MODULE = "cpid_drake.logs.files"
JSON = Format((".json",), read_json, write_json)


def test_a_log_in_an_added_format_is_identified_from(added, run_cpid):
    results = []
    for log in (SAMPLE, "log.json"):
        options = ("--estimator", "least_squares", "--json", "found.txt")
        assert run_cpid("identify", log, *FREE_FLYER, *options)[0] == 0
        results.append(json.loads(Path("found.txt").read_text()))
    for key in ("parameters", "covariance"):
        assert results[0][key] == results[1][key]
    code, stdout, _ = run_cpid("telemetry", "check", "log.json")
    assert code == 0
    assert "no problems found" in stdout


def test_messages_name_an_added_format(added, run_cpid):
    Path("log.xml").write_text("")
    code, _, stderr = run_cpid("identify", "log.xml", *FREE_FLYER)
    assert code == 2
    assert ".csv, .npz, .parquet, .json, .mcap, .db3 files" in stderr
    with pytest.raises(InputError, match=r"is written as \.csv, \.npz, \.parquet, \.json"):
        write_telemetry("log.mcap", read_telemetry("log.json"))
