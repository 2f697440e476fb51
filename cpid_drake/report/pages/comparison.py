"""A comparison of results: its tables on the terminal, and its page."""

from collections.abc import Sequence

import numpy as np

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.files.digits import significant
from cpid_drake.identification.comparison import Comparison
from cpid_drake.identification.figure import compared_bars
from cpid_drake.report.page import Report, Section, Table
from cpid_drake.report.sections.data import written_by

_WIDTH = 31
"""Number of characters of a drawn interval."""


def comparison_report(comparison: Comparison) -> Report:
    """Return the page of a comparison."""
    names = " and ".join(comparison.results)
    verdict = comparison.verdict[0].upper() + comparison.verdict[1:]
    sections = [
        Section(
            "Parameters",
            warnings=[f"{text}." for text in comparison.warnings],
            figures=[compared_bars(comparison.results, _distance_words(comparison))],
            columns=1,
            half=True,
        ),
        Section(
            "Numbers",
            texts=[
                "The errors of the results are taken to be independent. Errors of one spacecraft "
                "or of its sensors are not: to hold them in common, identify the logs together.",
            ],
            tables=[interval_table(comparison)],
            half=True,
        ),
        Section(
            "Agreement",
            tables=[agreement_table(comparison)],
            facts=[written_by()],
        ),
    ]
    if comparison.differences:
        sections.insert(2, Section("Differences", tables=[differences_table(comparison)]))
    return Report(f"{names} compared", f"{verdict}.", sections)


def _distance_words(comparison: Comparison) -> list[str]:
    """Return how far each parameter of the results is from that of the first, in words."""
    words = []
    for name, apart in zip(PARAMETER_NAMES, comparison.distances().T, strict=True):
        first, *others = (result[name] for result in comparison.results.values())
        largest = np.nanmax(np.abs(apart[1:]), initial=-1.0)
        text = f", {largest:.1f} σ apart" if largest >= 0 else ""
        words.append(" against ".join(each.shown() for each in (first, *others)[:2]))
        words[-1] += f" {first.unit}{text}"
    return words


def interval_table(comparison: Comparison, *, is_drawn: bool = False) -> Table:
    """Return the parameters of all results over each other.

    Args:
        comparison: the comparison.
        is_drawn: whether intervals are also drawn in characters, for the terminal.

    """
    rows, distances = [], comparison.distances()
    for i, name in enumerate(PARAMETER_NAMES):
        each = [result[name] for result in comparison.results.values()]
        bars = _bars([estimate.interval for estimate in each], [e.value for e in each])
        for k, (label, estimate) in enumerate(zip(comparison.results, each, strict=True)):
            row = ["" if k else name, label, estimate.shown(), estimate.shown_interval()]
            row += [bars[k]] * is_drawn
            distance = distances[k, i]
            apart = f"{distance:+.1f}" if k and np.isfinite(distance) else ""
            rows.append([*row, estimate.unit, apart])
    heads = ["", "result", "estimate", "95 % interval", *[""] * is_drawn, "unit", "differs [σ]"]
    first = next(iter(comparison.results))
    return Table(heads, rows, note=f"Differs: from {first}, in σ of the difference.")


def agreement_table(comparison: Comparison) -> Table:
    """Return how far each result is from all others, and its failed checks."""
    rows = []
    for name, result in comparison.results.items():
        check = comparison.checks[name]
        numbers = [
            significant(x, 3) if x is not None else "" for x in (check.statistic, check.limit)
        ]
        words = "nothing in common"
        if check.statistic is not None:
            words = "agrees" if check.passed else "differs"
        failed = ", ".join(each.name for each in result.checks if not each.passed)
        rows.append([name, words, *numbers, f"{result.rank} of {result.most}", failed or "none"])
    heads = ["", "with the others", "χ²", "fails above", "rank", "failed checks"]
    return Table(heads, rows)


def differences_table(comparison: Comparison) -> Table:
    """Return what differs in logs, requests and checks."""
    rows = [[name, *words] for name, words in comparison.differences.items()]
    return Table(["", *comparison.results], rows, note="What is equal is not in this table.")


def _bars(intervals: Sequence[tuple[float, float]], values: Sequence[float]) -> list[str]:
    """Return intervals on one scale, as lines of characters; empty without both ends."""
    ends = np.array(intervals)
    low, high = np.fmin.reduce(ends, axis=None), np.fmax.reduce(ends, axis=None)
    bars = []
    for (start, end), value in zip(intervals, values, strict=True):
        if not (np.isfinite([start, end, value]).all() and high > low):
            bars.append("")
            continue
        first, last, middle = (
            round((x - low) / (high - low) * (_WIDTH - 1)) for x in (start, end, value)
        )
        line = [" "] * first + ["─"] * (last - first + 1) + [" "] * (_WIDTH - 1 - last)
        line[first], line[last] = "├", "┤"
        line[min(max(middle, 0), _WIDTH - 1)] = "●"
        bars.append("".join(line))
    return bars
