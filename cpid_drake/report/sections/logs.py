"""The section that compares a joint estimate with the estimates from each log and from a prior."""

from itertools import zip_longest

import numpy as np

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.identification.description import agreement_words, decimals
from cpid_drake.identification.result import Identification
from cpid_drake.report.page import Cell, Section, Table


def logs_section(result: Identification) -> Section:
    """Return the section with the separate estimates beside the joint one."""
    texts = [
        f"{len(result.logs)} sources of one target; each log has its own start, momentum and "
        f"biases. They {agreement_words(result)}."
    ]
    return Section("Logs", texts=texts, tables=[_facts(result), _estimates(result)])


def _facts(result: Identification) -> Table:
    rows: list[list[Cell | str]] = []
    for (name, part), source in zip_longest(result.logs.items(), result.sources):
        rows.append(
            [
                name,
                "" if source is None else f"{source.start:.6g} to {source.end:.6g} s",
                Cell(str(part.sample_count)),
                Cell(str(part.rank)),
                agreement_words(part),
                "; ".join(part.failures) or "none",
            ]
        )
    heads = ["", "time window", "samples", "rank", "agreement", "failed checks"]
    note = "Agreement: χ² of the difference from all others, for the same target."
    return Table(heads, rows, note=note)


def _estimates(result: Identification) -> Table:
    parts = {"together": result, **result.logs}
    rows: list[list[Cell | str]] = []
    for i, (name, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS)):
        cells = [_cell(part.parameters[i], part.intervals[i]) for part in parts.values()]
        rows.append([name, *cells, unit])
    heads = ["", *parts, "unit"]
    return Table(heads, rows, "Estimates with 95 % intervals, together and each on its own")


def _cell(value: float, interval: np.ndarray) -> Cell:
    if not np.isfinite(value):
        return Cell("not known")
    width = float(interval[1] - interval[0])
    places = decimals(width)
    return Cell(f"{value:.{places}f} ± {width / 2:.{places}f}", float(value))
