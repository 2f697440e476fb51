"""`cpid export`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cpid_drake.errors import InputError

if TYPE_CHECKING:
    from cpid_drake.dynamics.inertia import InertialParameters
    from cpid_drake.identification.result_files import IdentificationResult


def export(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT", help="What `cpid identify --json` has written.")
    ],
    format: Annotated[
        str, typer.Option(help="urdf, sdf, mjcf, or drake-yaml for Drake model directives.")
    ],
    out: Annotated[Path, typer.Option(help="File to write; the ending must be the format's.")],
    with_spacecraft: Annotated[
        bool,
        typer.Option("--with-spacecraft", help="Write the spacecraft with the target attached."),
    ] = False,
    name: Annotated[
        str | None, typer.Option(help="The target's name. Default: target, or one that is free.")
    ] = None,
    raw: Annotated[
        bool,
        typer.Option("--raw", help="The estimate as it is, not the nearest possible body."),
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite what exists.")] = False,
) -> None:
    """Write an identified target as a model: URDF, SDF, MJCF or Drake model directives."""
    from rich.console import Console

    from cpid_drake.identification.result_files import read_result
    from cpid_drake.spacecraft.export.files import export_target
    from cpid_drake.spacecraft.spacecraft import Spacecraft

    found = read_result(result)
    parameters = _parameters(found, raw, result)
    spacecraft = None
    if with_spacecraft:
        source = found.spacecraft
        spacecraft = Spacecraft(
            source.model,
            base=source.base,
            capture_frame=source.capture_frame,
            packages=source.packages,
        )
    written = export_target(
        parameters, out, format=format, spacecraft=spacecraft, name=name, overwrite=force
    )
    log = Console(stderr=True, markup=False, soft_wrap=True)
    if written.name != (name or "target"):
        log.print(f"the model has a 'target' already: this one is '{written.name}'")
    for file in written.files:
        log.print(f"{file}: read again by Drake, and as meant", highlight=False)


def _parameters(found: "IdentificationResult", raw: bool, where: Path) -> "InertialParameters":
    """Return what to export, or say why there is nothing."""
    from cpid_drake.dynamics.inertia import InertialParameters
    from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES

    unknown = [name for name, value in zip(PARAMETER_NAMES, found.parameters) if value != value]
    if unknown:
        raise InputError(
            f"{where}: nothing to export: the data do not determine {', '.join(unknown)} (rank "
            f"{found.rank} of 10); turn the target about further axes and identify again"
        )
    if not raw:
        if found.feasible is None:
            raise InputError(f"{where}: nothing to export: 'feasible' is null")
        return found.feasible
    parameters = InertialParameters.from_vector(found.parameters)
    problems = parameters.infeasibilities()
    if problems:
        raise InputError(
            f"{where}: the estimate as it is cannot be exported: {'; '.join(problems)}; without "
            "--raw the nearest possible one is"
        )
    return parameters
