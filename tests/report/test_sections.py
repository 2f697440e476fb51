"""The numbers of sections and tables, from results whose numbers are known."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import norm, t

from cpid_drake import InertialParameters
from cpid_drake.dynamics.parameterizations import STANDARD
from cpid_drake.estimation.least_squares import LeastSquaresSolution
from cpid_drake.estimation.whiteness import Whiteness, whiteness
from cpid_drake.identification.description import describe, result_of
from cpid_drake.identification.result import Identification, ResidualSeries
from cpid_drake.identification.result_files import (
    SpacecraftReference,
    write_result,
)
from cpid_drake.report.accuracy import tables
from cpid_drake.report.figures import motion_pictures
from cpid_drake.report.findings import Findings
from cpid_drake.report.page import Table
from cpid_drake.report.pages.identification import identification_report
from cpid_drake.report.replay import estimate_text
from cpid_drake.report.sections.observability import observability_section
from cpid_drake.report.sections.residuals import residuals_section
from cpid_drake.report.sections.result import result_section
from cpid_drake.report.sections.sensors import sensors_section
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.presets import load_sensors
from cpid_drake.sensing.thinning import excerpt_of
from cpid_drake.studies.accuracy import AccuracyStudy
from cpid_drake.studies.statistics import Accuracy

TARGET = InertialParameters(10.0, [0.1, -0.2, 0.3], np.diag([2.0, 3.0, 4.0]))
SIGMA = np.array([0.4, *3 * [0.01], *3 * [0.05], *3 * [0.02]])
CRAFT = SpacecraftReference("arm.urdf", "body", "hand")


@pytest.fixture
def found():
    """An identification of `TARGET` from 16 rows, the standard deviations being `SIGMA`."""
    estimate = STANDARD.from_parameters(TARGET.to_vector())
    inverse = np.linalg.inv(STANDARD.jacobian(estimate))
    covariance = inverse @ np.diag(SIGMA**2) @ inverse.T
    solution = LeastSquaresSolution(
        estimate,
        covariance,
        np.linalg.inv(covariance),
        rank=10,
        singular_values=np.linspace(10.0, 1.0, 10),
        condition_number=10.0,
        unobservable=np.empty((0, 10)),
        residual_rms=1.0,
        row_count=16,
        values=estimate,
        unit=np.ones(10),
    )
    return Identification(STANDARD, solution, 8, "least_squares", "standard")


def column(table: Table, head: str) -> list[str]:
    k = list(table.heads).index(head)
    return [getattr(row[k], "text", row[k]) for row in table.rows]


class TestIntervals:
    """Two-sided, of Student's t if the residuals gave the noise, wherever they are read."""

    @pytest.fixture(params=["noise from residuals", "noise known"])
    def case(self, request, found):
        if request.param == "noise known":
            return replace(found, sensors=load_sensors("testbed")), norm.ppf(0.975)
        return found, t.ppf(0.975, 16 - 10)

    def test_in_the_text(self, case):
        found, factor = case
        lines = describe(found, result_of(found, CRAFT))
        line = next(line.split() for line in lines if line.split()[:1] == ["m"])
        low, high = float(line[2].strip("[,")), float(line[3].strip("]"))
        assert high - low == pytest.approx(2 * factor * 0.4, abs=0.02)
        assert (low + high) / 2 == pytest.approx(10.0, abs=0.01)

    def test_in_the_json(self, case, tmp_path):
        found, factor = case
        write_result(tmp_path / "r.json", result_of(found, CRAFT))
        pairs = np.array(json.loads((tmp_path / "r.json").read_text())["interval_95"])
        np.testing.assert_allclose(np.diff(pairs)[:, 0], 2 * factor * SIGMA)

    def test_in_the_report(self, case):
        found, factor = case
        table = result_section(result_of(found, CRAFT), None).tables[0]
        half = np.array(column(table, "± 95 %"), dtype=float)
        np.testing.assert_allclose(half, factor * SIGMA, rtol=0.02)

    def test_in_the_replay(self, case):
        found, factor = case
        line = next(line for line in estimate_text(found).splitlines() if " m 10.00 kg" in line)
        assert float(line.split("±")[1]) == pytest.approx(factor * 0.4, rel=0.05)

    def test_in_the_report_of_a_file_without_intervals(self, found):
        result = replace(result_of(found, CRAFT), interval_95=None)
        half = np.array(column(result_section(result, None).tables[0], "± 95 %"), dtype=float)
        np.testing.assert_allclose(half, norm.ppf(0.975) * SIGMA, rtol=0.02)


class TestResult:
    def test_errors_are_estimate_minus_truth_and_in_standard_deviations(self, found):
        vector = TARGET.to_vector()
        vector[0] -= 0.8
        truth = InertialParameters.from_vector(vector)
        table = result_section(result_of(found, CRAFT), truth).tables[0]
        assert column(table, "error")[0] == "+0.8"
        assert column(table, "error / σ")[0] == "+2.0"
        assert float(column(table, "truth")[0]) == pytest.approx(9.2)
        assert set(column(table, "error / σ")[1:]) <= {"+0.0", "-0.0"}

    def test_principal_axes_stand_beside_their_moments(self, found):
        turned = InertialParameters(10.0, [0, 0, 0], [[3, 0, 1], [0, 9, 0], [1, 0, 8]])
        moments, axes = np.linalg.eigh(turned.I_TTcm_C)
        result = replace(result_of(found, CRAFT), principal_moments=moments, principal_axes=axes)
        table = result_section(result, None).tables[1]
        for k in range(3):
            axis = [float(column(table, f"axis {name}")[k]) for name in "xyz"]
            moment = float(column(table, "moment [kg·m²]")[k])
            np.testing.assert_allclose(turned.I_TTcm_C @ axis, np.multiply(moment, axis), atol=2e-3)

    def test_what_is_not_consistent_is_called_so(self, found):
        result = replace(result_of(found, CRAFT), infeasibilities=("mass is negative",))
        (text,) = result_section(result, None).texts
        assert "physically inconsistent (mass is negative)" in text


class TestObservability:
    def test_relative_standard_deviations(self, found):
        """Of the mass, of the radius of gyration, and of the trace of the inertia."""
        (table,) = observability_section(result_of(found, CRAFT)).tables
        shares = [float(cell.text) for cell in table.rows[0][1:]]
        assert shares[0] == pytest.approx(100 * 0.4 / 10.0, rel=0.05)
        assert shares[4] == pytest.approx(100 * 0.05 / 9.0, rel=0.05)
        assert shares[7] == pytest.approx(100 * 0.02 / 9.0, rel=0.05)


class TestResiduals:
    def test_sizes_and_whiteness(self, found):
        """A slow wave is not white, noise is; sizes are root mean squares of each axis."""
        time = np.arange(400.0)
        noise = np.random.default_rng(3).normal(size=(400, 3)) * [1.0, 2.0, 3.0]
        wave = np.sin(time[:, None] / 20 + np.arange(3))
        series = {
            name: ResidualSeries(time, value, "σ") for name, value in (("a", noise), ("b", wave))
        }
        (table,) = residuals_section(
            replace(found, residuals=series, whiteness=whiteness(wave))
        ).tables
        assert column(table, "white") == ["yes", "no"]
        for k, axis in enumerate("xyz"):
            expected = np.sqrt(np.mean(noise[:, k] ** 2))
            assert float(column(table, f"rms {axis}")[0]) == pytest.approx(expected, rel=0.01)

    @pytest.mark.parametrize(
        ("rows", "lag_one", "meaning"),
        [
            (None, 0.02, "white"),
            (None, 0.3, "the intervals include it"),
            (None, 0.9, "a check failed"),
            ("standard", 0.9, "19 samples count as one in the intervals"),
        ],
    )
    def test_page_and_lines_give_correlated_residuals_one_meaning(
        self, found, rows, lag_one, meaning
    ):
        time = (1 + lag_one) / (1 - lag_one)
        series = {"gyro": ResidualSeries(np.arange(9.0), np.ones((9, 3)), "σ")}
        white = Whiteness(lag_one, 0.1, time, 400)
        doubts = ("no noise",) if "failed" in meaning else ()
        found = replace(found, rows=rows, residuals=series, whiteness=white, doubts=doubts)
        lines = "\n".join(describe(found, result_of(found, CRAFT)))
        page = residuals_section(found).texts[0]
        words = f"correlation of neighbours {lag_one:+.3f}: {meaning}"
        assert words in lines
        assert words in page
        assert "more than noise" not in page


def test_a_page_whose_check_failed_says_so_first(found):
    doubt = "the momentum is <not> zero"
    for doubts in ((), (doubt,)):
        result = result_of(replace(found, doubts=doubts), CRAFT)
        page = identification_report(Findings(result, "{}", None, "no log"))
        assert ("a check failed" in page.title) == bool(doubts)
        assert page.subtitle.startswith(f"Do not use this estimate: {doubt}.") == bool(doubts)
    assert "a check failed</title>" in page.html()
    assert "Do not use this estimate: the momentum is &lt;not&gt; zero." in page.html()


def test_the_sensors_section_compares_samples_with_the_assumed_noise(found):
    """χ² is the mean square of residuals in units of the noise; periods are in milliseconds."""
    time, values = np.arange(4) / 50, np.array([[1.0, -1, 1], [-2, 2, 2], [1, 1, 1], [2, 2, -2]])
    measurements = Measurements(
        ("j",),
        attitude=Samples(np.empty(0), np.empty((0, 4))),
        gyro=Samples(time, np.zeros((4, 3))),
        position=Samples(np.empty(0), np.empty((0, 3))),
        velocity=Samples(np.empty(0), np.empty((0, 3))),
        encoders=Samples(time, np.zeros((4, 1))),
        joint_rates=Samples(np.empty(0), np.empty((0, 1))),
    )
    suite = load_sensors("testbed")
    found = replace(
        found,
        sensors=suite,
        residuals={"gyro": ResidualSeries(time, values, "σ")},
        rejected={"gyro": 7},
    )
    section = sensors_section(
        SimpleNamespace(found=found, sensors=suite, excerpt=excerpt_of(measurements))
    )
    assert section.texts[0] == "The noise of the sensors was given."
    (table,) = section.tables
    assert column(table, "samples") == ["4", "4"]
    assert column(table, "every [ms]") == ["20", "20"]
    assert column(table, "not used") == ["7", "0"]
    assert column(table, "χ² per reading") == ["2.500", ""]
    assert float(column(table, "σ assumed")[0]) == pytest.approx(suite.sigmas("gyro")[0], rel=0.05)


def test_pictures_of_the_base_s_motion_name_their_units():
    """Rates in degrees, small displacements in millimetres from the first sample on."""
    time, drawn = np.arange(3.0), {}
    empty = Samples(np.empty(0), np.empty((0, 3)))
    joints = Samples(time, np.zeros((3, 1)))
    quaternion = Samples(np.empty(0), np.empty((0, 4)))
    measurements = Measurements(
        ("j",),
        attitude=quaternion,
        gyro=Samples(time, np.full((3, 3), np.pi / 180)),
        position=Samples(time, 5.0 + 0.01 * time[:, None] * np.ones(3)),
        velocity=empty,
        encoders=joints,
        joint_rates=Samples(np.empty(0), np.empty((0, 1))),
    )
    for picture in motion_pictures(measurements):
        _, samples, label = picture.draw.args
        drawn[picture.name] = samples.value, label
    value, label = drawn["base-rate"]
    np.testing.assert_allclose(value, 1.0)
    assert "deg/s" in label
    value, label = drawn["base-position"]
    np.testing.assert_allclose(value[:, 0], [0.0, 10.0, 20.0], atol=1e-9)
    assert "mm" in label


def test_the_accuracy_table_marks_intervals_that_are_not_honest():
    """A NEES within its band has no mark; ratios are error over bound."""

    def entry(estimator: str, nees: float) -> Accuracy:
        return Accuracy(
            preset="flight",
            estimator=estimator,
            trials=10,
            failed=0,
            problem="",
            bias=np.full(10, 0.3),
            bias_halfwidth=np.full(10, 0.1),
            rmse=np.full(10, 0.5),
            crlb=np.full(10, 0.25),
            ratio_interval=np.ones((2, 10)),
            nees_mean=nees,
            nees_band=(8.0, 12.0),
            coverage=np.linspace(0.5, 1.0, 10),
            coverage_interval=np.ones((2, 10)),
            coverage_all=0.75,
            within_one_percent=np.linspace(0.2, 1.0, 10),
            infeasible=0,
            detected=None,
        )

    study = AccuracyStudy((entry("good", 10.0), entry("bad", 20.0)), np.full(10, 5.0), 1, 10, ())
    (table,) = tables(study)
    rows = list(zip(*(map(str, c.cells) for c in table.columns)))
    by_name = {name.strip(): cells for name, *cells in rows}
    assert by_name["m"] == ["5", "2.00", "2.00"]
    assert by_name["NEES"] == ["10", "10", "20 !"]
    assert by_name["95 % coverage"][1:] == ["75 %", "75 %"]
    assert by_name["least"][1:] == ["50 %", "50 %"]
    assert by_name["most"][1:] == ["100 %", "100 %"]
    assert by_name["within 1 %"][1:] == ["20 %", "20 %"]
    assert by_name["bias / spread"][1] == "0.75"
