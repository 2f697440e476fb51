"""`cpid export`."""

from typing import Literal

from cpid_drake.commands import options
from cpid_drake.files.errors import InputError
from cpid_drake.files.overwriting import check_outputs
from cpid_drake.identification.result_files import read_result
from cpid_drake.spacecraft.target_export import export_target, free_name


def export(
    result: options.Result,
    /,
    *,
    format: Literal["urdf", "sdf", "mjcf", "drake-yaml"],
    out: options.File,
    with_spacecraft: bool = False,
    name: options.Name | None = None,
    raw: bool = False,
    allow_failed_checks: bool = False,
    force: options.Force = False,
) -> None:
    """Export an identified target as a model: URDF, SDF, MJCF or Drake model directives.

    Args:
        format: Format; drake-yaml: model directives.
        out: File to write; its ending must fit the format.
        with_spacecraft: Write the spacecraft with the target attached.
        name: Name of the target's body. Default: target, or target_2 etc. if it is taken.
        raw: Export the raw estimate, not the nearest physically consistent one.
        allow_failed_checks: Export a result although a check failed.

    """
    identified = read_result(result)
    if identified.failures and not allow_failed_checks:
        raise InputError(
            f"{result}: nothing exported, because a check of the result failed: "
            f"{identified.failures[0]}; --allow-failed-checks exports it all the same"
        )
    target = identified.raw() if raw else identified.consistent
    if target is None:
        reason = (
            "no rigid body is near the estimate"
            if identified.is_identifiable
            else identified.explain()
        )
        raise InputError(f"{result}: nothing to export: {reason}")
    spacecraft = None
    if with_spacecraft:
        source = identified.spacecraft
        if source is None:
            raise InputError(f"{result}: the result does not name its spacecraft")
        spacecraft = source.make()
    check_outputs([("--out", out)], [result, *identified.files()], force=force)
    chosen, log = free_name(name, spacecraft), options.log_console()
    written = export_target(
        out, target, format=format, spacecraft=spacecraft, name=chosen, overwrite=force
    )
    if chosen != (name or "target"):
        log.print(f"the model already has a 'target'; the exported one is '{chosen}'")
    for file in written:
        log.print(f"{file}: written; Drake reads the same parameters from it")
