"""`cpid export`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cpid_drake.commands.options import ForceOption, ResultArgument, log_console
from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES
from cpid_drake.errors import InputError
from cpid_drake.identification.result import Identification
from cpid_drake.identification.result_files import read_result
from cpid_drake.output_files.overwriting import MODEL, Output, check_outputs
from cpid_drake.spacecraft.export import export_target
from cpid_drake.spacecraft.spacecraft import Spacecraft


class Format(StrEnum):
    """Kinds of models; the last are Drake's model directives."""

    URDF = "urdf"
    SDF = "sdf"
    MJCF = "mjcf"
    DRAKE = "drake-yaml"


def export(
    result: ResultArgument,
    format: Annotated[Format, typer.Option(help="Format; drake-yaml: model directives.")],
    out: Annotated[
        Path, typer.Option(metavar="FILE", help="File to write; its ending must fit the format.")
    ],
    with_spacecraft: Annotated[
        bool,
        typer.Option("--with-spacecraft", help="Write the spacecraft with the target attached."),
    ] = False,
    name: Annotated[
        str | None,
        typer.Option(
            help="Name of the target's body. Default: target, or target_2 etc. if it is taken."
        ),
    ] = None,
    raw: Annotated[
        bool,
        typer.Option(
            "--raw", help="Export the raw estimate, not the nearest physically consistent one."
        ),
    ] = False,
    allow_failed_checks: Annotated[
        bool,
        typer.Option("--allow-failed-checks", help="Export a result although a check failed."),
    ] = False,
    force: ForceOption = False,
) -> None:
    """Export an identified target as a model: URDF, SDF, MJCF or Drake model directives."""
    found = read_result(result)
    if found.failures and not allow_failed_checks:
        raise InputError(
            f"{result}: nothing exported, because a check of the result failed: "
            f"{found.failures[0]}; --allow-failed-checks exports it all the same"
        )
    parameters = _parameters(found, raw, result)
    spacecraft = None
    if with_spacecraft:
        source = found.spacecraft
        if source is None:
            raise InputError(f"{result}: the result does not name its spacecraft")
        spacecraft = Spacecraft(
            source.model,
            base=source.base,
            capture_frame=source.capture_frame,
            packages=source.packages,
        )
    check_outputs([Output("--out", out, MODEL)], [result, *found.files()], force=force)
    written = export_target(
        parameters, out, format=format.value, spacecraft=spacecraft, name=name, overwrite=force
    )
    log = log_console()
    if written.name != (name or "target"):
        log.print(f"the model already has a 'target'; the exported one is '{written.name}'")
    for file in written.files:
        log.print(f"{file}: written; Drake reads the same parameters from it")


def _parameters(found: Identification, raw: bool, where: Path) -> InertialParameters:
    """Return the parameters to export.

    Raises:
        InputError: not all ten are known, or a raw estimate is not physically consistent.

    """
    unknown = [name for name, value in zip(PARAMETER_NAMES, found.parameters) if value != value]
    if unknown:
        raise InputError(
            f"{where}: nothing to export: the data do not determine {', '.join(unknown)} (rank "
            f"{found.rank} of 10); rotate the target about more axes and identify again"
        )
    if not raw:
        if found.consistent is None:
            raise InputError(f"{where}: nothing to export: no rigid body is near the estimate")
        return found.consistent
    parameters = InertialParameters.from_vector(found.parameters)
    problems = parameters.infeasibilities()
    if problems:
        raise InputError(
            f"{where}: the raw estimate cannot be exported: {'; '.join(problems)}; leave --raw out "
            "to export the nearest physically consistent one"
        )
    return parameters
