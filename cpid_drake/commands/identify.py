"""`cpid identify`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.commands.report import check_page
from cpid_drake.commands.telemetry import topics_of
from cpid_drake.errors import InputError

NOT_ALL_KNOWN = 3
"""Exit code where the data leave something of the target open."""


def identify(
    telemetry: Annotated[
        str, typer.Argument(metavar="TELEMETRY", help="CSV, NPZ, Parquet or ROS 2 bag.")
    ],
    spacecraft: Annotated[
        str, typer.Option(metavar="MODEL", help="The known spacecraft: URDF, SDF, MJCF, ...")
    ],
    base: Annotated[str, typer.Option(metavar="NAME", help="Its base body.")],
    capture_frame: Annotated[
        str, typer.Option(metavar="NAME", help="The frame or link that holds the target.")
    ],
    estimator: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="least_squares, trajectory_fit or momentum_filter. Default: trajectory_fit with "
            "--sensors, else least_squares.",
        ),
    ] = None,
    rows: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Rows of least_squares: standard (default), relative or eq18."
        ),
    ] = None,
    sensors: Annotated[
        str | None,
        typer.Option(
            metavar="PRESET|YAML",
            help="How good the sensors are. Default: told from the log where it matters.",
        ),
    ] = None,
    unknown_momentum: Annotated[
        bool,
        typer.Option("--unknown-momentum", help="The total momentum is not known to be zero."),
    ] = False,
    start: Annotated[
        float | None, typer.Option("--from", metavar="T0", help="First time to use, in seconds.")
    ] = None,
    end: Annotated[
        float | None, typer.Option("--to", metavar="T1", help="Last time to use, in seconds.")
    ] = None,
    package: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FOLDER", help="A package that the model's URIs name; may be repeated."
        ),
    ] = None,
    topic: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND=/NAME",
            help="Topic of a bag with several: odometry, pose, imu or joints; may be repeated.",
        ),
    ] = None,
    leave_out_bad: Annotated[
        bool,
        typer.Option("--leave-out-bad", help="Leave out rows that have a problem, and count them."),
    ] = False,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write the result there.")
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option("--report", metavar="FILE", help="Write a report there: one HTML page."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but warnings.")] = False,
) -> int:
    """Identify what a spacecraft holds from a log of its motion.

    Exit codes: 0 all ten parameters are known; 2 bad input or usage; 3 the data leave some open.
    """
    from cpid_drake.identification.description import describe
    from cpid_drake.identification.requests import Request, identify_file
    from cpid_drake.identification.result_files import SpacecraftReference, write_result

    log = Console(stderr=True, markup=False, highlight=False, soft_wrap=True)
    if json_file is not None and not json_file.parent.is_dir():
        raise InputError(f"--json {json_file}: there is no folder {json_file.parent}")
    if report is not None:
        check_page("--report", report)
    folders = packages_of(package)
    request = Request(
        telemetry,
        SpacecraftReference(absolute_model(spacecraft), base, capture_frame, folders),
        estimator=estimator,
        rows=rows,
        sensors=sensors,
        unknown_momentum=unknown_momentum,
        start=start,
        end=end,
        topics=topics_of(topic),
        leave_out_bad=leave_out_bad,
    )
    with Console(stderr=True, quiet=quiet).status("identifying") as status:
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
        log.print(f"note: columns without a meaning: {', '.join(evidence.ignored[:20])}")
    for warning in result.warnings:
        log.print(f"warning: {warning}")
    if not quiet:
        Console(markup=False, highlight=False, soft_wrap=True).print(
            "\n".join(describe(evidence.found, result))
        )
    return 0 if evidence.found.identification.is_observable else NOT_ALL_KNOWN


def packages_of(package: list[str] | None) -> dict[str, str]:
    """Return the folders of packages, by name, that --package gives."""
    packages = {}
    for entry in package or []:
        name, separator, folder = entry.partition("=")
        if not (name and separator and folder):
            raise InputError(f"--package {entry}: give NAME=FOLDER")
        packages[name] = str(Path(folder).absolute())
    return packages


def absolute_model(model: str) -> str:
    """Return a model's path from the root, or its URI as it is."""
    return model if "://" in model else str(Path(model).expanduser().absolute())
