"""A result for people: printed, in a notebook, one parameter of it, and its figure."""

import re
from dataclasses import replace

import numpy as np
import pytest
from flyer_cases import SAMPLE, flyer

from cpid_drake import (
    PARAMETER_NAMES,
    InertialParameters,
    InputError,
    identify,
    load_sensors,
    read_log,
)
from cpid_drake.dynamics.parameterizations import parameter_scale, relative_parameterization
from cpid_drake.identification.checks import Check
from cpid_drake.identification.result import extremes

FAILED = Check("halves", "the first half has another target")
TENSOR = [[0.16, 0.012, -0.008], [0.012, 0.19, 0.01], [-0.008, 0.01, 0.25]]
BAG = InertialParameters(8.5, [0.26, 0.02, -0.015], TENSOR)


@pytest.fixture(scope="module")
def craft():
    return flyer()


@pytest.fixture(scope="module")
def log():
    return read_log(SAMPLE)


@pytest.fixture(scope="module")
def result(craft, log):
    return identify(craft, log, sensors=load_sensors("testbed", unstated="exact"))


@pytest.fixture(scope="module")
def unknown(craft, log):
    """From so short a log that nothing is determined, but m has a lower bound."""
    return identify(craft, log.between(0.0, 0.5), sensors=load_sensors("testbed", unstated="exact"))


def failing(result):
    return replace(result, checks=(FAILED, *result.checks))


def test_a_parameter_has_value_sigma_and_interval(result):
    for k, name in enumerate(PARAMETER_NAMES):
        found = result[name]
        assert (found.name, found.value) == (name, result.parameters[k])
        assert found.sigma == np.sqrt(result.covariance[k, k])
        assert found.interval == tuple(result.shown_intervals[k])
        low, high = found.interval
        assert low < found.value < high
        name_shown, shown = re.match(r"(\w+) = (\S+) ", repr(found)).groups()
        assert name_shown == name
        assert abs(float(shown) - found.value) < 0.1 * found.sigma
    assert (result["m"].unit, result["cx"].unit, result["Ixy"].unit) == ("kg", "m", "kg·m²")


def test_an_unknown_name_is_answered_with_the_ten(result):
    with pytest.raises(InputError, match=f"no parameter 'mass'.*{', '.join(PARAMETER_NAMES)}"):
        _ = result["mass"]


def test_what_is_not_known_is_no_number(unknown):
    assert unknown.rank < 10
    for k, name in enumerate(PARAMETER_NAMES):
        found = unknown[name]
        assert np.isnan(found.value)
        assert np.isnan(found.sigma)
        np.testing.assert_array_equal(found.interval, unknown.shown_intervals[k])
        assert repr(found).startswith(f"{name} not identifiable")
        assert "nan" not in repr(found)
    ends = re.search(r"95 % in \[(\S+), (\S+)\] kg", repr(unknown["m"])).groups()
    low, high = unknown.shown_intervals[0]
    np.testing.assert_allclose(np.array(ends, float), [low, high], atol=0.01 * (high - low))


def test_a_failed_check_goes_with_every_number(result):
    doubted = failing(result)
    assert result["m"].checks_passed
    assert not doubted["m"].checks_passed
    assert "a check failed" in repr(doubted["m"])
    assert "a check failed" not in repr(result["m"])
    assert str(doubted).startswith(f"failed check: {FAILED.sentence}")
    assert "<b>Failed check: the first half" in doubted._repr_html_()
    assert FAILED.sentence in doubted.plot().layout.title.text.replace("<br>", " ")


def test_a_repr_is_one_line(result, unknown, craft, log):
    assert "rank 10 of 10; m = 8." in repr(result)
    assert "no check failed" in repr(result)
    assert "failed checks: halves" in repr(failing(result))
    assert "m not identifiable" in repr(unknown)
    assert "free_flyer.urdf: base body, capture frame capture_point, 10.49 kg" in repr(craft)
    assert "arm_joint1, arm_joint2, arm_joint3, arm_joint4" in repr(craft)
    assert repr(craft.on_table()).endswith("; on a table)")
    assert "0 to 10 s: attitude 1001, gyro 1001, position 1001, encoders 1001" in repr(log)
    assert repr(type(log)(())) == "Log(no samples; joints: none)"
    for each in (result, unknown, craft, log):
        assert len(repr(each).splitlines()) == 1
        assert len(repr(each)) < 200


def test_warnings_are_printed_first(result):
    said = replace(result, warnings=("the momentum may not be zero",))
    assert str(said) == f"warning: the momentum may not be zero\n{result}"


def test_principal_moments_and_axes_have_the_digits_that_the_covariance_allows(result):
    """The last digit is below σ, and not below a thousandth of it; σ by drawing targets."""
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(result.parameters, result.covariance, 2000)
    tensors = [InertialParameters.from_vector(row).I_TTcm_C for row in draws]
    moments, axes = np.linalg.eigh(tensors)
    shown = re.findall(r"^ +(\S+)   \((.*)\)$", str(result), re.M)
    assert len(shown) == 3
    nearest = np.linalg.eigh(result.consistent.I_TTcm_C)
    for k, (moment, axis) in enumerate(shown):
        sigma, last = np.std(moments[:, k]), 10.0 ** -len(moment.split(".")[1])
        assert sigma / 1000 < last < sigma
        assert float(moment) == pytest.approx(nearest[0][k], abs=last)
        signs = np.sign(axes[:, :, k] @ nearest[1][:, k])
        sigma = np.std(signs[:, None] * axes[:, :, k], axis=0).max()
        entries = axis.split(", ")
        last = 10.0 ** -len(entries[0].split(".")[1])
        assert last < sigma or last == pytest.approx(1e-5)


def test_a_coarse_estimate_shows_axes_with_few_digits(result):
    coarse = replace(result, covariance=1e4 * result.covariance)
    [first, *_] = re.findall(r"^ +\S+   \((.*)\)$", str(coarse), re.M)
    assert len(first.split(",")[0].split(".")[1]) < 5


class TestHtml:
    def test_it_has_the_cells_of_the_printed_table(self, result, unknown):
        for each in (result, unknown):
            rows = re.findall(r"<tr>(.*?)</tr>", each._repr_html_())
            cells = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in rows]
            assert len(cells) == 11
            printed = str(each)
            for row in cells:
                assert " ".join(row).split() in [line.split() for line in printed.splitlines()]

    def test_it_sets_no_colour_of_text_or_page(self, result):
        """A notebook may be dark."""
        styles = re.findall(r'style="(.*?)"', failing(result)._repr_html_())
        declared = [each.split(": ") for style in styles for each in style.split("; ")]
        assert {value for key, value in declared if key == "color"} <= {"inherit"}
        assert {value for key, value in declared if "background" in key} <= {"none"}

    def test_text_is_escaped(self, result):
        said = replace(result, warnings=("<script>alert(1)</script>",), estimator="<b>")
        html = said._repr_html_()
        assert "<script>" not in html
        assert "&lt;script&gt;" in html
        assert "by &lt;b&gt;," in html


class TestFigure:
    def test_it_shows_each_parameter_with_interval_and_truth(self, result):
        """All on one axis, from the estimate, in per cent of m, radius of gyration and tr I."""
        figure = result.plot(BAG)
        scale = parameter_scale(result.consistent.to_vector())
        low, high = figure.layout.xaxis.range
        for k, name in enumerate(PARAMETER_NAMES):
            axis = f"x{k + 1}" if k else "x"
            marks = {each.name: each for each in figure.data if each.xaxis == axis}
            values = [*result.shown_intervals[k], result.parameters[k], BAG.to_vector()[k]]
            drawn = [marks[each] for each in ("95 % interval", "estimate", "true value")]
            np.testing.assert_allclose(np.concatenate([e.customdata for e in drawn]), values)
            off = 100 * (np.array(values) - result.parameters[k]) / scale[k]
            np.testing.assert_allclose(np.concatenate([each.x for each in drawn]), off, atol=1e-9)
            assert low < off.min() <= off.max() < high
            assert figure.layout[f"xaxis{k + 1 if k else ''}"].matches == "x"
            assert f"<b>{name}</b>  {result[name].in_words()}" == figure.layout.annotations[k].text

    def test_what_is_not_known_says_so(self, unknown):
        figure = unknown.plot()
        assert all("not identifiable" in each.text for each in figure.layout.annotations)
        assert np.isfinite(figure.layout.xaxis.range).all()


def test_of_a_target_without_mass_only_the_mass_has_bounds():
    """Its centre of mass is anywhere: c = (m c) / m has a pole there."""
    form, sigma = relative_parameterization(100.0), 1e-13
    found = extremes(form, np.zeros(10), sigma**2 * np.eye(10), 2.0)
    np.testing.assert_allclose(found[0], [-2 * sigma, 2 * sigma], rtol=1e-6)
    assert np.isnan(found[1:4]).all()
