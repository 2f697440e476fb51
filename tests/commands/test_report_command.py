"""`cpid report` and `cpid identify --report`: the pages they write, and refusals."""

import json
import re

import pytest
from flyer_cases import FREE_FLYER, SAMPLE

from cpid_drake.files.resources import models_directory
from cpid_drake.report.pages import identification


@pytest.fixture(scope="module", autouse=True)
def quick():
    """Pages without a scene: that is tested in a browser."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identification, "replay_html", lambda *args, **options: "scene")
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("report")


@pytest.fixture
def cpid(run_cpid, monkeypatch, folder):
    """Return a function that runs `cpid` in one folder: (code, stdout, stderr)."""
    monkeypatch.chdir(folder)
    return run_cpid


@pytest.fixture
def result(cpid, folder):
    """A result file and the page that was written with it."""
    if not (folder / "result.json").exists():
        files = ("--json", "result.json", "--report", "identified.html")
        options = ("--to", "2", "--sensors", "testbed", "--estimator", "least_squares", *files)
        # Two seconds are enough for a page; whether they are for a target is not the question.
        assert cpid("identify", SAMPLE, *FREE_FLYER, *options)[0] in (0, 3, 4)
    return folder / "result.json"


def table(page) -> list[str]:
    """The rows of the first table of a page."""
    text = page.read_text()
    return re.findall(r"<tr>(.*?)</tr>", text[: text.index("</table>")])


def test_a_result_s_report_is_that_of_its_identification(cpid, result, folder):
    code, stdout, stderr = cpid("report", "--result", result, "--out", "again.html", "--quiet")
    assert (code, stdout, stderr) == (0, "", "")
    rows = table(folder / "again.html")
    assert len(rows) == 11
    assert rows == table(folder / "identified.html")


@pytest.mark.slow
def test_a_run_s_report_has_the_truth(cpid, folder):
    text = (models_directory() / "scenario_template.yaml").read_text()
    shorter = text.replace("simulation:\n  duration: 10.0", "simulation:\n  duration: 3.0")
    assert shorter != text
    (folder / "short.yaml").write_text(shorter.replace("accuracy: 3.0e-11", "accuracy: 3.0e-10"))
    assert cpid("simulate", "short.yaml", "--out", "run", "--quiet")[0] == 0
    code, stdout, stderr = cpid("report", "--run", "run", "--out", "run.html")
    assert (code, stdout, stderr) == (0, "", "run.html\n")
    truth = json.loads((folder / "run/truth.json").read_text())
    page = (folder / "run.html").read_text()
    assert json.loads(re.search(r'id="data-truth">(.*?)</script>', page, re.DOTALL)[1]) == truth
    assert "error / σ" in page
    for name in ("parameters", "convergence", "residuals", "identifiability", "base-motion"):
        assert f'id="{name}"' in page


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        (["--result", "result.json", "--base", "bus", "--out", "r.html"], "give no others"),
        (["--out", "r.html"], "give one of LOG, --result FILE and --run FOLDER"),
        ([SAMPLE, "--base", "body", "--out", "r.html"], "give --spacecraft, or all of --model"),
        (["--run", "empty", "--out", "r.html"], "not a whole run: there is no run.json"),
        (["--run", "broken", "--out", "r.html"], "run.json: "),
        (["--result", "result.json", "--out", "empty"], "is a folder; name a file"),
    ],
)
def test_what_cannot_be_is_one_line(refusal, result, folder, arguments, phrase):
    for name in ("empty", "broken"):
        (folder / name).mkdir(exist_ok=True)
    for name in ("run.json", "truth.json", "scenario.yaml", "telemetry.csv"):
        (folder / "broken" / name).write_text("{}")
    assert phrase in refusal("report", *arguments)
