"""The section that compares a joint estimate with the estimates from each log and from a prior."""

from collections.abc import Sequence
from itertools import zip_longest

import numpy as np

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.identification.description import decimals
from cpid_drake.identification.result import (
    Identification,
    JointEstimate,
    SeparateEstimate,
    Source,
)
from cpid_drake.report.page import Cell, Section, Table


def logs_section(result: Identification, joint: JointEstimate) -> Section:
    """Return the section with the separate estimates beside the joint one."""
    tables = [_facts(joint.parts, result.sources), _estimates(result, joint.parts)]
    return Section("Logs", texts=_texts(joint), tables=tables)


def _texts(joint: JointEstimate) -> list[str]:
    texts = []
    if len(joint.logs) > 1:
        texts.append(
            f"{len(joint.logs)} logs of one target, each with its own start, momentum and biases. "
            f"Their estimates differ by χ² = {joint.chi_squared:.4g} for {joint.freedom} "
            f"combinations of parameters; the probability of a larger difference is "
            f"{joint.probability:.2g} if all logs have the same target."
        )
    if joint.prior is not None:
        dominated = ", ".join(joint.dominated) or "no parameter"
        texts.append(f"A prior was used. It determines {dominated} more than the samples do.")
    return texts


def _name(part: SeparateEstimate) -> str:
    return part.name or "the log"


def _facts(parts: Sequence[SeparateEstimate], sources: Sequence[Source]) -> Table:
    rows: list[list[Cell | str]] = []
    for part, source in zip_longest(parts, sources):  # the prior, which is last, has no source
        window = "" if source is None else f"{source.start:.6g} to {source.end:.6g} s"
        rows.append(
            [
                _name(part),
                window,
                Cell(str(part.sample_count)),
                Cell(str(part.rank)),
                Cell(f"{part.probability:.2g}"),
                "; ".join(part.doubts) or "none",
            ]
        )
    heads = ["", "time window", "samples", "rank", "agreement", "failed checks"]
    note = "Agreement: probability of a larger difference from all others, for the same target."
    return Table(heads, rows, note=note)


def _estimates(result: Identification, parts: Sequence[SeparateEstimate]) -> Table:
    rows: list[list[Cell | str]] = []
    for i, (name, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS)):
        row: list[Cell | str] = [name, _cell(result.parameters[i], result.intervals[i])]
        row += [_cell(part.parameters[i], part.intervals[i]) for part in parts]
        rows.append([*row, unit])
    heads = ["", "together", *map(_name, parts), "unit"]
    return Table(heads, rows, "Estimates with 95 % intervals, together and each on its own")


def _cell(value: float, interval: np.ndarray) -> Cell:
    if not np.isfinite(value):
        return Cell("not known")
    width = float(interval[1] - interval[0])
    places = decimals(width)
    return Cell(f"{value:.{places}f} ± {width / 2:.{places}f}", float(value))
