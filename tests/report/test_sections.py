"""The numbers of sections and tables, from results whose numbers are known."""

import re
from dataclasses import replace

import numpy as np
import pytest
from processes import ROOT
from scipy.stats import norm, t

from cpid_drake import InertialParameters
from cpid_drake.dynamics.parameterizations import STANDARD
from cpid_drake.estimation.gaussian import Gaussian, solution_of
from cpid_drake.identification.checks import Check
from cpid_drake.identification.request import Request, Source
from cpid_drake.identification.result import Identification
from cpid_drake.planning.prediction import Prediction
from cpid_drake.report.contents import ReportContents
from cpid_drake.report.page import Table
from cpid_drake.report.pages.identification import identification_report
from cpid_drake.report.plan_tables import motion_table
from cpid_drake.report.sections.data import checks_section
from cpid_drake.report.sections.estimate import logs_section, numbers_section
from cpid_drake.report.sections.next_steps import next_sections
from cpid_drake.sensors.presets import load_sensors
from cpid_drake.spacecraft.reference import SpacecraftReference

TARGET = InertialParameters(10.0, [0.1, -0.2, 0.3], np.diag([2.0, 3.0, 4.0]))
SIGMA = np.array([0.4, *3 * [0.01], *3 * [0.05], *3 * [0.02]])
CRAFT = SpacecraftReference("arm.urdf", "body", "hand")


@pytest.fixture
def found():
    """An identification of `TARGET` from 16 rows, the standard deviations being `SIGMA`."""
    estimate = STANDARD.from_parameters(TARGET.to_vector())
    inverse = np.linalg.inv(STANDARD.jacobian(estimate))
    covariance = inverse @ np.diag(SIGMA**2) @ inverse.T
    root = np.linalg.cholesky(np.linalg.inv(covariance)).T
    rows = Gaussian.of_rows({"x": 10}, np.column_stack([root, root @ estimate]))
    solution = solution_of(rows, estimate, 1e6 * np.ones(10), row_count=16)
    return Identification.of_solution(
        STANDARD,
        solution,
        sample_count=8,
        estimator="least_squares",
        rows="standard",
        sources=(Source(Request("log.csv", CRAFT), {}, 0.0, 1.0, ""),),
    )


def column(table: Table, head: str) -> list[str]:
    k = list(table.heads).index(head)
    return [row[k] for row in table.rows]


class TestIntervals:
    """Two-sided, of Student's t if the residuals gave the noise, wherever they are read."""

    @pytest.fixture(params=["noise from residuals", "noise known"])
    def case(self, request, found):
        if request.param == "noise known":
            options = {"sample_count": 8, "estimator": "trajectory_fit", "sources": found.sources}
            solution, suite = found.solution, load_sensors("testbed")
            known = Identification.of_solution(STANDARD, solution, sensors=suite, **options)
            return known, norm.ppf(0.975)
        return found, t.ppf(0.975, 16 - 10)

    def test_in_the_report(self, case):
        found, factor = case
        table = numbers_section(found, None).tables[0]
        ends = np.array(
            [each.split(" to ") for each in column(table, "95 % interval")], dtype=float
        )
        np.testing.assert_allclose(np.diff(ends)[:, 0], 2 * factor * SIGMA, rtol=0.02)


def test_several_logs_stand_side_by_side_with_half_their_intervals(found):
    """The half-width of a log that knows half as much is twice as large."""
    poor = replace(found, covariance=4 * found.covariance, intervals=wider(found, 2))
    [table] = logs_section(replace(found, logs={"a": found, "b": poor})).tables
    row = next(row for row in table.rows if row[0] == "m")
    half = 0.4 * t.ppf(0.975, 16 - 10)
    for head, factor in (("together", 1), ("a", 1), ("b", 2)):
        cell = row[list(table.heads).index(head)]
        value, own = (float(each) for each in cell.split(" ± "))
        assert value == pytest.approx(10.0, abs=0.1)
        assert own == pytest.approx(factor * half, rel=0.06)


def wider(found, factor):
    """Return intervals that are wider by a factor."""
    middle = found.intervals.mean(axis=1, keepdims=True)
    return middle + factor * (found.intervals - middle)


def test_a_plan_s_table_is_in_degrees_and_percent():
    one = np.ones(10)
    prediction = Prediction(
        0.02 * one, 0.02 * one, 2 * one, np.pi / 6, np.pi / 180, 0.25, {"rate": 0.5}
    )
    table = motion_table({"plan": prediction}, "")
    shown = {row[0]: float(row[1]) for row in table.rows}
    assert shown["rotation of the base, deg"] == pytest.approx(30.0, rel=0.01)
    assert shown["its rate, deg/s"] == pytest.approx(1.0, rel=0.01)
    assert shown["its displacement, m"] == pytest.approx(0.25)
    assert shown["worst σ, % of scale"] == pytest.approx(1.0)


def test_the_error_is_estimate_minus_truth_in_sigma(found):
    truth = InertialParameters(10.8, TARGET.p_CTcm_C, TARGET.I_TTcm_C)
    table = numbers_section(found, truth).tables[0]
    assert column(table, "error / σ") == ["-2.0", *9 * ["+0.0"]]
    assert column(table, "truth")[0] == "10.80"


def test_a_failed_check_has_the_advice_of_the_documentation(found):
    """The table of docs/how-to/symptoms.md is the longer text; its last column is on the page."""
    text = (ROOT / "docs/how-to/symptoms.md").read_text().split("## The answer is not complete")[0]
    rows = re.findall(r"^\| `([^`]+)`.* \| .* \| (.*) \|$", text, re.M)
    assert len(rows) > 15
    for name, advice in rows:
        plain = re.sub(r"\[(.*?)\]\(.*?\)", r"\1", advice).replace("`", "")
        check = Check(name.replace("…", "gyro"), "the sentence")
        [section] = next_sections(replace(found, checks=(check,)), [])
        assert section.facts == [(check.name, plain)]


def test_the_first_sentence_names_at_most_two_failed_checks(found):
    names = ("halves", "noise", "log")
    result = replace(found, checks=tuple(Check(name, "no") for name in names))
    page = identification_report(ReportContents(result))
    assert page.title == "Checks failed: halves, noise and 1 more"


def test_a_page_whose_check_failed_says_so_first(found):
    failure = "the momentum is <not> zero"
    for checks in ((), (Check("momentum", failure),)):
        result = replace(found, checks=checks)
        page = identification_report(ReportContents(result, missing="no log"))
        assert page.title.startswith(
            "A check failed: momentum" if checks else "m = 10.00 ± 0.98 kg"
        )
        assert page.subtitle.startswith(f"Do not use this estimate: {failure}.") == bool(checks)
        passed = Check.of("misfit", "", 1.5, 3.0)
        table = checks_section(replace(found, checks=(*checks, passed))).tables[0]
        assert column(table, "statistic") == [*("" for _ in checks), "1.5"]
        assert [row[-1] for row in table.rows] == [*("failed" for _ in checks), "passed"]
    assert "<title>A check failed: momentum</title>" in page.html()
    assert "Do not use this estimate: the momentum is &lt;not&gt; zero." in page.html()
