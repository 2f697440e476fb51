"""`cpid identify`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.commands import options

NOT_ALL_KNOWN = 3
"""Exit code if the data do not determine all ten parameters."""


def identify(
    telemetry: Annotated[str, typer.Argument(metavar="TELEMETRY", help=options.LOG_KINDS)],
    spacecraft: options.ModelOption[str],
    base: options.BaseOption[str],
    capture_frame: options.CaptureFrameOption[str],
    estimator: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Estimator, such as least_squares, trajectory_fit or momentum_filter; an unknown "
            "name lists all. Default: trajectory_fit with --sensors, else least_squares.",
        ),
    ] = None,
    rows: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Row family of least_squares, such as standard, relative or eq18; an unknown name "
            "lists all. Default: standard, or relative for logs without position and velocity.",
        ),
    ] = None,
    sensors: options.SensorsOption = None,
    momentum: options.MomentumOption = None,
    start: Annotated[
        float | None, typer.Option("--from", metavar="T0", help="First time to use, in seconds.")
    ] = None,
    end: Annotated[
        float | None, typer.Option("--to", metavar="T1", help="Last time to use, in seconds.")
    ] = None,
    package: options.PackageOption = None,
    topic: options.TopicOption = None,
    leave_out_bad: Annotated[
        bool, typer.Option("--leave-out-bad", help="Leave out and count rows that have a problem.")
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the result to this file.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write a report, one HTML page.")
    ] = None,
    quiet: options.QuietOption = False,
) -> int:
    """Identify the target that a spacecraft holds from a log of the spacecraft's motion.

    Exit codes: 0 all ten parameters are known; 2 bad input or usage; 3 not all ten are determined.
    """
    for option, path in (("--json", json_file), ("--report", report)):
        if path is not None:
            options.check_output(option, path)
    packages, topics = options.packages_of(package), options.topics_of(topic)
    model = options.absolute_model(spacecraft)
    options.check_inputs(telemetry, model, sensors)
    options.check_method(estimator, rows, momentum or "zero", sensors)
    from cpid_drake.identification.description import describe
    from cpid_drake.identification.requests import Request, identify_file
    from cpid_drake.identification.result_files import SpacecraftReference, write_result

    log = options.log_console()
    request = Request(
        telemetry,
        SpacecraftReference(model, base, capture_frame, packages),
        estimator=estimator,
        rows=rows,
        sensors=sensors,
        momentum=momentum or "zero",
        start=start,
        end=end,
        topics=topics,
        leave_out_bad=leave_out_bad,
    )
    with options.log_console(quiet).status("identifying") as status:
        evidence = identify_file(request, status.update)
        result = evidence.result
        if json_file is not None:
            write_result(json_file, result)
        if report is not None:
            import logging

            from cpid_drake.report.findings import findings_of
            from cpid_drake.report.pages.identification import identification_report

            logging.getLogger("drake").setLevel(logging.WARNING)
            findings = findings_of(evidence, status.update)
            identification_report(findings, progress=status.update).write(report)
    if evidence.ignored:
        log.print(f"note: ignored columns: {', '.join(evidence.ignored[:20])}")
    for warning in result.warnings:
        log.print(f"warning: {warning}")
    if not quiet:
        Console(markup=False, highlight=False, soft_wrap=True).print(
            "\n".join(describe(evidence.found, result))
        )
    return 0 if evidence.found.is_observable else NOT_ALL_KNOWN
