"""The section that compares a joint estimate with the estimates from each log and from a prior."""

import numpy as np

from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.identification.description import decimals
from cpid_drake.identification.result_files import IdentificationResult, JointRecord, SeparateRecord
from cpid_drake.report.page import Cell, Section, Table


def logs_section(result: IdentificationResult, joint: JointRecord) -> Section:
    """Return the section with the separate estimates beside the joint one."""
    parts = joint.logs if joint.prior is None else [*joint.logs, joint.prior]
    return Section("Logs", texts=_texts(joint), tables=[_facts(parts), _estimates(result, parts)])


def _texts(joint: JointRecord) -> list[str]:
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


def _name(part: SeparateRecord) -> str:
    return part.name or "the log"


def _facts(parts: list[SeparateRecord]) -> Table:
    rows: list[list[Cell | str]] = []
    for part in parts:
        source = part.source
        window = "" if source is None else f"{source.start:.6g} to {source.end:.6g} s"
        rows.append(
            [
                _name(part),
                window,
                Cell(str(part.samples_used)),
                Cell(str(part.rank)),
                Cell(f"{part.probability:.2g}"),
                "; ".join(part.doubts) or "none",
            ]
        )
    heads = ["", "time window", "samples", "rank", "agreement", "doubts"]
    note = "Agreement: probability of a larger difference from all others, for the same target."
    return Table(heads, rows, note=note)


def _estimates(result: IdentificationResult, parts: list[SeparateRecord]) -> Table:
    intervals = result.interval_95
    whole = np.full((10, 2), np.nan) if intervals is None else intervals
    rows: list[list[Cell | str]] = []
    for i, (name, unit) in enumerate(zip(PARAMETER_NAMES, PARAMETER_UNITS)):
        row: list[Cell | str] = [name, _cell(result.parameters[i], whole[i])]
        row += [_cell(part.parameters[i], part.interval_95[i]) for part in parts]
        rows.append([*row, unit])
    heads = ["", "together", *map(_name, parts), "unit"]
    return Table(heads, rows, "Estimates with 95 % intervals, together and each on its own")


def _cell(value: float, interval: np.ndarray) -> Cell:
    if not np.isfinite(value):
        return Cell("not known")
    width = float(interval[1] - interval[0])
    places = decimals(width)
    return Cell(f"{value:.{places}f} ± {width / 2:.{places}f}", float(value))
