"""`cpid identify` reads long logs as streams by itself; results and pages stay the same kind."""

import json

import numpy as np
import pytest

from cpid_drake.identification import checked_log, requests
from cpid_drake.resources import models_directory

SAMPLE = models_directory() / "telemetry/free_flyer.csv"
FREE_FLYER = (
    *("--spacecraft", models_directory() / "free_flyer/free_flyer.urdf"),
    *("--base", "body", "--capture-frame", "capture_point", "--sensors", "testbed"),
)


@pytest.fixture
def identified(run_cpid, tmp_path, monkeypatch):
    """Return a function that identifies from the sample: its result and its page."""
    monkeypatch.chdir(tmp_path)

    def run(*options):
        files = ("--json", "found.json", "--report", "page.html")
        code, _, stderr = run_cpid("identify", SAMPLE, *FREE_FLYER, *options, *files)
        assert code == 0, stderr
        result = json.loads((tmp_path / "found.json").read_text())
        return result, (tmp_path / "page.html").read_text()

    return run


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["least_squares", "recursive_fit"])
def test_a_stream_gives_the_result_and_the_page_of_a_log_in_memory(
    identified, short_reports, monkeypatch, estimator
):
    options = ("--estimator", estimator, "--from", "0.5", "--to", "9.5")
    whole, _ = identified(*options)
    for module in (checked_log, requests):
        monkeypatch.setattr(module, "LONGEST_HEAD", 100)
    # Chunks of a second: a log of ten seconds is a long one.
    monkeypatch.setitem(requests.open_telemetry.__kwdefaults__, "seconds", 1.0)
    streamed, page = identified(*options)
    assert streamed["source"] == whole["source"]
    assert streamed["samples_used"] == whole["samples_used"]
    sigma = np.sqrt(np.diag(np.array(whole["covariance"])))
    for key, part in (("mass", slice(0, 1)), ("com", slice(1, 4)), ("inertia", slice(4, 10))):
        difference = np.ravel(streamed[key]) - np.ravel(whole[key])
        assert (np.abs(difference) <= 0.02 * sigma[part]).all()
    assert "The log is long: these are its first" in page
    assert len(page) < 5_000_000
