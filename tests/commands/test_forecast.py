"""The announcement of a long job."""

import pytest

from cpid_drake.commands import forecast
from cpid_drake.commands.forecast import Forecast, duration_text


def announced(monkeypatch, steps, **options) -> list[str]:
    """Return what is announced after steps (time, done) of a job of size 200."""
    clock, said = iter([time for time, _ in steps]), []
    monkeypatch.setattr(forecast.time, "perf_counter", lambda: next(clock))
    job = Forecast("200 trials take", 200, said.append, **options)
    for _, done in steps:
        job.update(done)
    return said


def test_the_duration_follows_from_the_first_trials_and_is_said_once(monkeypatch):
    """The start of the processes, before the first trial, does not count."""
    steps = [(30.0, 1), (31.0, 2), (33.6, 3), (40.0, 9)]
    assert announced(monkeypatch, steps, least=2) == ["200 trials take about 6 minutes"]


def test_a_short_job_is_not_announced(monkeypatch):
    assert announced(monkeypatch, [(0.0, 1), (2.1, 150), (2.5, 200)]) == []


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(12.3, "12 s"), (47, "50 s"), (100, "2 minutes"), (360, "6 minutes"), (9000, "2.5 hours")],
)
def test_durations_in_words(seconds, text):
    assert duration_text(seconds) == text
