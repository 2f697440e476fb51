"""The figures of speed: which values fail, and that their page has all of them."""

import re

import pytest
from benchmark import COUNT, FIGURES, PAGE, RATIO, failures, is_beyond
from benchmark_long import FACTORS, growth

COUNTS = [figure for figure in FIGURES if figure.kind == COUNT]
RATIOS = [figure for figure in FIGURES if figure.kind == RATIO]


def measured(**changes: float) -> dict:
    """Return all figures at their limits; ratios or counts times these factors."""
    kinds = {COUNT: changes.get("counts", 1.0), RATIO: changes.get("ratios", 1.0)}
    return {(f.of, f.unit): kinds[f.kind] * f.limit for f in FIGURES}


def test_figures_at_their_limits_pass():
    assert list(failures([measured()])) == []


@pytest.mark.parametrize("factor", [1.001, 0.0, float("nan")])
def test_a_count_beyond_its_limit_fails_and_one_of_nothing(factor):
    lines = list(failures([measured(counts=factor), measured(counts=factor)]))
    assert len(lines) == len(COUNTS)
    assert all(line.startswith(figure.of) for line, figure in zip(lines, COUNTS))


def test_a_ratio_fails_beyond_twice_its_limit_if_two_repetitions_agree():
    quiet, busy = measured(ratios=1.99), measured(ratios=2.01)
    assert list(failures([quiet])) == []
    assert list(failures([busy, quiet])) == []
    assert len(list(failures([busy, busy]))) == len(RATIOS)


def test_the_page_has_each_figure_within_its_limit():
    page = PAGE.read_text(encoding="utf-8")
    for figure in FIGURES:
        [cell] = re.findall(rf"^\| {re.escape(figure.of)} \|.*\| (.*) \|$", page, re.M)
        [value] = re.findall(rf"([\d.,]+) {re.escape(figure.unit)}(?:;|$)", cell)
        assert not is_beyond(figure, float(value.replace(",", ""))), figure


@pytest.mark.parametrize("figure", FACTORS)
def test_a_figure_that_grows_over_the_minutes_fails(figure):
    for factor, fails in ((0.99 * FACTORS[figure], False), (1.01 * FACTORS[figure], True)):
        [(line, is_grown)] = growth({figure: ([9.0, 1.0, 1.0], [factor, factor, 9.0])})
        assert line.startswith(figure)
        assert is_grown == fails
