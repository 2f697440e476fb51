"""Commands are run in empty folders, and what must be refused is refused in one line."""

import pytest

from cpid_drake.report.pages import identification


@pytest.fixture
def cpid(run_cpid, monkeypatch, tmp_path):
    """Return a function that runs `cpid` in an empty folder: (code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)
    return run_cpid


@pytest.fixture
def refusal(cpid):
    """Return a function that runs what must be refused in one line, and gives the line."""

    def run(*arguments):
        code, stdout, stderr = cpid(*arguments)
        assert (code, stdout) == (2, ""), stderr
        assert stderr.startswith("cpid: error: ")
        assert stderr.count("\n") == 1
        return stderr

    return run


@pytest.fixture
def short_reports(monkeypatch):
    """Reports have no replay: it is tested elsewhere."""
    monkeypatch.setattr(identification, "replay_html", lambda *_, **options: "<p>replay</p>")
