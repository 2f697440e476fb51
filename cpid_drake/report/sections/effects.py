"""The sections with errors of the sensors and external forces: declared ones, and others."""

from collections.abc import Sequence

from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.identification.effects import EffectEstimate, UndeclaredErrors
from cpid_drake.identification.result import Identification
from cpid_drake.report.page import Cell, Section, Table


def effects_section(result: Identification) -> Section:
    """Return the section with a row for every entry of every estimated effect."""
    return Section(
        "Estimated errors and forces",
        texts=["The sensors' file declares these unknown constants; they were estimated as well."],
        tables=[_estimates(result.effects, "effects")],
    )


def undeclared_section(undeclared: UndeclaredErrors) -> Section:
    """Return the section about errors that the samples show and the sensors do not declare."""
    texts = [
        "The sensors' file does not declare these constants, but the samples show them.",
        *undeclared.verdict(),
    ]
    gains = undeclared.alone
    rows: list[list[Cell | str]] = [[name, Cell(f"{gain:.1f}", gain)] for name, gain in gains]
    return Section(
        "Errors that are not declared",
        texts=texts,
        tables=[
            _estimates(undeclared.effects, "undeclared.effects"),
            Table(["", "gain"], rows, note="Gain of the log evidence by each of them alone."),
        ],
    )


def _estimates(effects: Sequence[EffectEstimate], key: str) -> Table:
    """Return the table of the estimates; `key` is their path in the embedded JSON."""
    rows: list[list[Cell | str]] = []
    for k, effect in enumerate(effects):
        for i, (value, sigma) in enumerate(zip(effect.value, effect.sigma)):
            half = quantile_95() * sigma
            rows.append(
                [
                    effect.name if i == 0 else "",
                    Cell(f"{value:.4g}", float(value), f"{key}.{k}.value.{i}"),
                    Cell(f"{half:.2g}"),
                    Cell(f"{quantile_95() * effect.prior_sigma:.2g}"),
                    effect.unit,
                ]
            )
    heads = ["", "estimate", "± 95 %", "± 95 % before", "unit"]
    texts = [effect.describe() for effect in effects]
    return Table(heads, rows, note=" ".join(f"{text[0].upper()}{text[1:]}." for text in texts))
