"""Results of one target agree, those of two do not, and what else differs is said."""

from dataclasses import replace

import numpy as np
import pytest
from planar_cases import SUITE, planar_craft, samples
from scipy.stats import chi2
from sensing_cases import Sines, measured

from cpid_drake import (
    InertialParameters,
    InputError,
    TotalMomentum,
    compare,
    identify,
    write_result,
)
from cpid_drake.dynamics.parameterizations import parameter_scale, relative_parameterization
from cpid_drake.identification.checks import Check
from cpid_drake.identification.request import Request, Source
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.report.pages.comparison import comparison_report
from cpid_drake.spacecraft.reference import SpacecraftReference

DRAWS = 60


def heavier(target, share) -> InertialParameters:
    return InertialParameters((1 + share) * target.mass, target.p_CTcm_C, target.I_TTcm_C)


@pytest.fixture(scope="module")
def identified(craft, suite):
    """Return a function (seed, target, options) -> the result of a log of its own motion."""

    def make(seed, target, **options):
        exact = measured(craft, Sines.drawn(4, 101 + seed, 5.0, 0.6), target, suite)
        return identify(craft, add_noise(suite, exact, seed=seed), sensors=suite, **options)

    return make


@pytest.fixture(scope="module")
def results(identified, skewed_target):
    """Results of two logs of one target."""
    return {name: identified(k, skewed_target) for k, name in enumerate("ab")}


def drawn(result, psi, rng):
    """Return a result whose unknowns are normal about ψ, with its covariance."""
    own = result.combinations
    covariance = np.linalg.inv(own.information)
    values = rng.multivariate_normal(psi, covariance, method="cholesky")
    form = relative_parameterization(own.known_mass)
    combinations = replace(own, values=values)
    return replace(result, parameters=form.to_parameters(values), combinations=combinations)


def of_log(result, name, **others):
    """Return a result as from a file of a log."""
    craft = SpacecraftReference("craft.urdf", "base", others.pop("frame", "hand"))
    source = Source(Request(name, craft, **others), {"telemetry": name}, 0.0, 5.0, "1.0.0")
    return replace(result, sources=(source,))


def test_results_of_one_target_agree(results):
    comparison = compare(results)
    assert comparison.is_same_target
    assert comparison.check.statistic < chi2.isf(1e-3, 10)
    assert str(comparison).startswith("the results agree with one target")
    assert np.abs(comparison.distances()).max() < 4


def test_two_errors_that_are_independent_are_apart_by_both(results):
    """Of a result and one with the same σ that is off by one of it: 1/√2 of σ."""
    one = results["a"]
    off = one.parameters + np.sqrt(np.diag(one.covariance))
    other = replace(one, parameters=off, combinations=None)
    distances = compare({"one": one, "other": other}).distances()
    np.testing.assert_allclose(distances[1], np.sqrt(0.5), rtol=1e-6)
    np.testing.assert_allclose(distances[0], 0.0, atol=1e-12)


def test_a_heavier_target_is_another_one(identified, results, skewed_target):
    other = identified(2, heavier(skewed_target, 0.05))
    comparison = compare({"a": results["a"], "other": other})
    assert comparison.is_same_target is False
    assert "do not have the same target, most in m: 59.99" in comparison.verdict
    three = compare({**results, "other": other})
    assert "do not have the same target: other differs from the rest" in three.verdict
    assert not three.checks["other"].passed


def test_the_statistic_is_that_of_the_difference_of_the_unknowns(results):
    a, b = (each.combinations for each in results.values())
    apart = a.values - b.values
    covariance = np.linalg.inv(a.information) + np.linalg.inv(b.information)
    expected = apart @ np.linalg.solve(covariance, apart)
    assert compare(results).check.statistic == pytest.approx(expected, rel=1e-4)


def test_targets_that_are_one_agree_and_others_differ(results):
    """Normal estimates: as often as the level says, and at 8 σ in 19 of 20."""
    rng = np.random.default_rng(11)
    a, b = results.values()
    psi = a.combinations.values
    covariance = sum(np.linalg.inv(each.combinations.information) for each in (a, b))
    statistics, differ = [], 0
    for _ in range(DRAWS):
        axis = rng.standard_normal(10)
        step = np.linalg.cholesky(covariance) @ (8 * axis / np.linalg.norm(axis))
        one, same, other = (drawn(e, p, rng) for e, p in ((a, psi), (b, psi), (b, psi + step)))
        comparison = compare([one, same])
        assert comparison.is_same_target
        statistics.append(comparison.check.statistic)
        differ += compare([one, other]).is_same_target is False
    assert np.mean(statistics) == pytest.approx(10.0, abs=4 * np.sqrt(20 / DRAWS))
    assert differ >= 0.95 * DRAWS


def test_results_in_other_unknowns_are_compared(identified, results, skewed_target):
    by_rows = identified(1, skewed_target, rows="standard")
    assert by_rows.combinations.unknowns == "standard"
    assert compare({"fit": results["a"], "rows": by_rows}).is_same_target
    wrong = identified(1, heavier(skewed_target, 0.3), rows="standard")
    assert compare({"fit": results["a"], "rows": wrong}).is_same_target is False


def test_what_is_known_from_one_result_only_is_not_compared(results):
    parts = []
    for k, each in enumerate(results.values()):
        own = each.combinations
        is_kept = (np.arange(10) < 4) == (k == 0)
        information = np.diag(np.where(is_kept, np.diag(own.information), 0.0))
        parts.append(replace(each, combinations=replace(own, information=information)))
    comparison = compare(parts)
    assert comparison.is_same_target is None
    assert comparison.verdict == "the results determine nothing in common"
    shared = compare([parts[0], results["b"]])
    assert shared.is_same_target
    assert shared.check.limit == pytest.approx(chi2.isf(1e-4, 4))


def test_results_on_a_table_are_compared_by_what_acts(tmp_path):
    craft, zero = planar_craft(tmp_path), TotalMomentum.zero()
    both = [
        identify(craft.on_table(), samples(craft, seed), sensors=SUITE, momentum=zero)
        for seed in (4, 5)
    ]
    comparison = compare(both)
    assert comparison.is_same_target
    assert comparison.check.limit == pytest.approx(chi2.isf(1e-4, 4))


def test_the_page_draws_all_intervals_on_one_axis(results):
    """From the first estimate on, in per cent of its size: equal lengths are equal errors."""
    comparison = compare(results)
    [section, *_] = comparison_report(comparison).sections
    [figure] = section.figures
    assert [trace.name for trace in figure.data if trace.showlegend] == ["a", "b"]
    first, *_ = results.values()
    scale = parameter_scale(first.consistent.to_vector())
    for k, apart in enumerate(comparison.distances()[1]):
        axis = f"x{k + 1}" if k else "x"
        for name, result in results.items():
            bar, point = (e for e in figure.data if (e.name, e.xaxis) == (name, axis))
            values = [*result.shown_intervals[k], result.parameters[k]]
            off = 100 * (np.array(values) - first.parameters[k]) / scale[k]
            np.testing.assert_allclose([*bar.x, *point.x], off, atol=1e-9)
        assert f", {abs(apart):.1f} σ apart" in figure.layout.annotations[k].text


def test_differences_of_requests_are_listed(results, tmp_path):
    a = of_log(results["a"], "a.csv", sensors="testbed")
    b = of_log(results["b"], "b.csv", sensors="flight")
    for name, each in (("a.json", a), ("b.json", b)):
        write_result(tmp_path / name, each)
    comparison = compare([tmp_path / "a.json", str(tmp_path / "b.json")])
    assert list(comparison.results) == ["a.json", "b.json"]
    assert comparison.differences["log"] == ("a.csv", "b.csv")
    assert comparison.differences["sensors"] == ("testbed", "flight")
    assert "spacecraft" not in comparison.differences
    assert comparison.warnings == ()


def test_results_of_one_log_are_not_independent(results):
    a, b = (of_log(each, "log.csv") for each in results.values())
    [warning] = compare({"a": a, "b": b}).warnings
    assert "a and b have a log or a prior in common" in warning
    [source] = b.sources
    later = replace(b, sources=(replace(source, start=5.0, end=9.0),))
    for pair in ({"a": a, "b": later}, {"a": later, "b": a}):
        assert compare(pair).warnings == ()


def test_a_prior_that_is_the_other_result_is_said(results, tmp_path):
    from cpid_drake.identification.identify_files import file_hash

    write_result(tmp_path / "a.json", of_log(results["a"], "a.csv"))
    b = of_log(results["b"], "b.csv")
    [source] = b.sources
    sha256 = {**source.sha256, "prior": file_hash(tmp_path / "a.json")}
    b = replace(b, sources=(replace(source, sha256=sha256),))
    assert "in common" in compare({"a": tmp_path / "a.json", "b": b}).warnings[0]


def test_a_failed_check_of_a_result_is_said(results):
    failed = replace(results["b"], checks=(Check("noise", "the noise is larger"),))
    comparison = compare({"a": results["a"], "b": failed})
    assert comparison.warnings == ("b: failed check: the noise is larger",)
    assert comparison.differences["failed checks"] == ("none", "noise")


@pytest.mark.parametrize(("share", "stands"), [(0.0, "agree"), (0.3, "do not have the same")])
def test_a_result_that_failed_its_checks_decides_nothing(results, share, stands):
    """Its numbers may be wrong by any amount: neither that they agree nor that they differ."""
    b = results["b"]
    other = replace(b, parameters=b.parameters * [1 + share, *np.ones(9)], combinations=None)
    failed = replace(other, checks=(Check("noise", "the noise is larger"),))
    comparison = compare({"a": results["a"], "b": failed})
    assert comparison.failed == ["b"]
    assert comparison.is_same_target is None
    assert comparison.verdict.startswith("not decided, because b failed checks")
    assert f"as they stand, the results {stands}" in comparison.verdict


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (lambda a, b: [a], "two results or more"),
        (lambda a, b: "a.json", "a list or a mapping"),
        (lambda a, b: [a, 3], "2: give a result or its file, not 3"),
        (lambda a, b: ["a.json", "a.json"], "a.json: is given twice"),
        (lambda a, b: [a, "none.json"], "none.json"),
        (lambda a, b: [of_log(a, "a"), of_log(b, "b", frame="wrist")], "in the capture frame"),
    ],
    ids=["one", "text", "number", "twice", "no-file", "frames"],
)
def test_what_cannot_be_compared_is_refused(results, given, message):
    with pytest.raises(InputError, match=message):
        compare(given(*results.values()))


def test_combinations_for_other_spacecraft_are_refused(results):
    a, b = results.values()
    own = replace(b.combinations, known_mass=2 * b.combinations.known_mass)
    unknown = np.full(10, np.nan)
    some = replace(b, parameters=unknown, covariance=np.full((10, 10), np.nan), combinations=own)
    with pytest.raises(InputError, match="2: the result determines combinations"):
        compare([a, some])
