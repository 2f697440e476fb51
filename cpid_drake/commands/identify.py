"""`cpid identify`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from cpid_drake.commands.telemetry import topics_of
from cpid_drake.errors import InputError

NOT_ALL_KNOWN = 3
"""Exit code where the data leave something of the target open."""


def identify(
    telemetry: Annotated[
        Path, typer.Argument(metavar="TELEMETRY", help="CSV, NPZ, Parquet or ROS 2 bag.")
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
        typer.Option(metavar="PRESET|YAML", help="How good the sensors are; default: see README."),
    ] = None,
    unknown_momentum: Annotated[
        bool,
        typer.Option("--unknown-momentum", help="The total momentum is not known to be zero."),
    ] = False,
    start: Annotated[
        float | None, typer.Option("--from", metavar="T0", help="First time to use [s].")
    ] = None,
    end: Annotated[
        float | None, typer.Option("--to", metavar="T1", help="Last time to use [s].")
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
    quiet: Annotated[bool, typer.Option("--quiet", help="Print nothing but warnings.")] = False,
) -> int:
    """Identify what a spacecraft holds from a log of its motion.

    Exit codes: 0 all ten parameters are known; 2 bad input or usage; 3 the data leave some open.
    """
    from cpid_drake.report.identification import describe, file_hash, result_of
    from cpid_drake.result_files import SpacecraftReference, write_result
    from cpid_drake.sensor_files import load_sensors
    from cpid_drake.spacecraft import Spacecraft
    from cpid_drake.telemetry_files import inspect_telemetry, refuse_problems
    from cpid_drake.telemetry_identification import identify_log

    log = Console(stderr=True, markup=False, highlight=False, soft_wrap=True)
    if json_file is not None and not json_file.parent.is_dir():
        raise InputError(f"--json {json_file}: there is no folder {json_file.parent}")
    with log.status("reading the model") as status:
        packages = _packages(package)
        craft = Spacecraft(spacecraft, base=base, capture_frame=capture_frame, packages=packages)
        suite = load_sensors(sensors) if sensors is not None else None
        status.update("reading the telemetry")
        found = inspect_telemetry(telemetry, topics=topics_of(topic))
        if not leave_out_bad:
            refuse_problems(found, str(telemetry))
        measurements, times = _window(found.measurements, start, end, str(telemetry))
        status.update("identifying")
        try:
            identified = identify_log(
                craft,
                measurements,
                estimator=estimator,
                rows=rows,
                suite=suite,
                unknown_momentum=unknown_momentum,
            )
        except InputError as error:
            raise InputError(f"{telemetry}: {error}") from error
    for name, count in found.partial.items():
        identified.rejected[name] = identified.rejected.get(name, 0) + count
    if found.problems.count:
        identified.rejected["rows"] = found.problems.count
    source = {
        "telemetry": str(telemetry),
        "sha256": file_hash(telemetry),
        "sensors": sensors,
        "unknown_momentum": unknown_momentum,
        **times,
    }
    folders = {name: str(Path(folder).absolute()) for name, folder in packages.items()}
    reference = SpacecraftReference(_absolute(spacecraft), base, capture_frame, folders)
    result = result_of(identified, reference, source)
    if json_file is not None:
        write_result(json_file, result)
    if found.ignored:
        log.print(f"note: columns without a meaning: {', '.join(found.ignored[:20])}")
    for warning in result.warnings:
        log.print(f"warning: {warning}")
    if not quiet:
        Console(markup=False, highlight=False, soft_wrap=True).print(
            "\n".join(describe(identified, result))
        )
    return 0 if identified.identification.is_observable else NOT_ALL_KNOWN


def _window(measurements, start: float | None, end: float | None, where: str):
    """Return the samples from `start` to `end`, times from the first on, and what times they are.

    The estimators' clock starts at the first sample: seconds since 1970 would cost digits.
    """
    from dataclasses import replace

    import numpy as np

    from cpid_drake.sensors import SENSOR_NAMES, Samples

    if start is not None or end is not None:
        first = -np.inf if start is None else start
        last = np.inf if end is None else end
        if not first < last:
            raise InputError(f"--from {first:g} --to {last:g}: nothing lies between them")
        measurements = measurements.between(first, last)
    parts = {name: getattr(measurements, name) for name in SENSOR_NAMES}
    times = np.concatenate([samples.time for samples in parts.values()])
    if not times.size:
        raise InputError(
            f"{where}: there are no samples"
            + (" between --from and --to" if start is not None or end is not None else "")
        )
    zero = times.min()
    moved = {name: Samples(samples.time - zero, samples.value) for name, samples in parts.items()}
    return replace(measurements, **moved), {"from": float(zero), "to": float(times.max())}


def _packages(package: list[str] | None) -> dict[str, str]:
    packages = {}
    for entry in package or []:
        name, separator, folder = entry.partition("=")
        if not (name and separator and folder):
            raise InputError(f"--package {entry}: give NAME=FOLDER")
        packages[name] = folder
    return packages


def _absolute(model: str) -> str:
    return model if "://" in model else str(Path(model).expanduser().absolute())
