"""An estimator and a row family, added from outside by one record each, serve all commands."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cpid_drake.dynamics.rows import RELATIVE_ROWS, ROW_FAMILIES, STANDARD_ROWS
from cpid_drake.identification import by_rows
from cpid_drake.identification.estimators import ESTIMATORS, Estimator
from cpid_drake.resources import models_directory

SAMPLE = models_directory() / "telemetry/free_flyer.csv"
FREE_FLYER = (
    *("--spacecraft", models_directory() / "free_flyer/free_flyer.urdf"),
    *("--base", "body", "--capture-frame", "capture_point"),
)


def estimate_every_second(known, logs, progress):
    """Least squares on every second sample: an estimator that somebody might try."""
    [log] = logs.values()
    names = ("attitude", "gyro", "position", "velocity", "encoders", "joint_rates")
    whole = log.measurements
    half = whole.updated({n: whole[n].where(slice(None, None, 2)) for n in names})
    rows = replace(known, family=RELATIVE_ROWS)
    found = by_rows.estimate(rows, {"": replace(log, measurements=half)})
    return replace(found, estimator="every_second", rows=None)


EVERY_SECOND = Estimator(
    name="every_second",
    label="least squares on every second sample",
    good_for="tests",
    estimate=estimate_every_second,
    reports=3,
)

# The same physics with the linear rows in g·m/s: another weighting, and so another estimate.
GRAMS = replace(
    STANDARD_ROWS,
    name="grams",
    augmented_rows=lambda samples: (
        STANDARD_ROWS.augmented_rows(samples)
        * np.tile([1e3, 1e3, 1e3, 1, 1, 1], len(samples))[:, None]
    ),
    momentum_size=0,
    momentum_columns=None,
    linear_unit="g·m/s",
)


@pytest.fixture(autouse=True)
def added(short_reports, monkeypatch, tmp_path):
    monkeypatch.setitem(ESTIMATORS, "every_second", EVERY_SECOND)
    monkeypatch.setitem(ROW_FAMILIES, "grams", GRAMS)
    monkeypatch.chdir(tmp_path)


def test_what_is_added_identifies_a_log(run_cpid):
    options = ("--estimator", "every_second")
    found = []
    for method in (("--rows", "relative"), options):
        assert run_cpid("identify", SAMPLE, *FREE_FLYER, *method, "--json", "found.txt")[0] == 0
        found.append(json.loads(Path("found.txt").read_text()))
    assert found[0]["parameters"] != found[1]["parameters"]
    assert found[1]["parameters"][0] == pytest.approx(8.5, rel=0.05)
    assert options[1] in (found[1]["estimator"], found[1]["rows"])


def test_messages_name_what_is_added(run_cpid):
    code, _, stderr = run_cpid("identify", SAMPLE, *FREE_FLYER, "--estimator", "best")
    assert code == 2
    assert "recursive_fit, trajectory_fit, every_second, eq18, standard, relative, grams" in stderr
    code, _, stderr = run_cpid(
        "identify", SAMPLE, *FREE_FLYER, "--rows", "grams", "--momentum", "unknown"
    )
    assert code == 2
    assert "rows 'grams' cannot estimate an unknown momentum" in stderr
