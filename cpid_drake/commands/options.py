"""Options that several commands share, and the checks of their values.

The checks import neither Drake nor SciPy: a wrong path or name is reported at once.
"""

import os
import shutil
import sys
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, TypeVar

import typer
from rich.console import Console

from cpid_drake.errors import InputError
from cpid_drake.output_files.drafts import refuse_unfinished
from cpid_drake.resources import MODELS_PACKAGE, resolve_model

T = TypeVar("T")

LOG_KINDS = "CSV, NPZ, Parquet or ROS 2 bag."

ScenarioArgument = Annotated[
    str,
    typer.Argument(metavar="SCENARIO", help="A scenario file, or the name of a shipped scenario."),
]
FolderOption = Annotated[Path, typer.Option(help="Output folder; created if it does not exist.")]
ModelOption = Annotated[
    T,
    typer.Option(
        "--spacecraft",
        metavar="MODEL",
        help="Model file of the known spacecraft: URDF, SDF, MJCF or Drake directives.",
    ),
]
BaseOption = Annotated[
    T, typer.Option("--base", metavar="NAME", help="Base body of the spacecraft.")
]
CaptureFrameOption = Annotated[
    T,
    typer.Option(
        "--capture-frame", metavar="NAME", help="Frame or link of the model that holds the target."
    ),
]
SensorsOption = Annotated[
    str | None,
    typer.Option(
        "--sensors",
        metavar="PRESET|YAML",
        help="Sensor noise: a preset or a YAML file. Default: estimated from the log if needed.",
    ),
]
MomentumOption = Annotated[
    str | None,
    typer.Option(
        "--momentum",
        metavar="zero|unknown",
        help="Total momentum of spacecraft and target: zero, or an unknown constant. Default: zero "
        "if the log agrees with that, else unknown.",
    ),
]
KnownBodiesOption = Annotated[
    str | None,
    typer.Option(
        "--known-bodies",
        metavar="KEY=NUMBER,...|YAML",
        help="Uncertainty of the spacecraft, 1 sigma, that the intervals include: mass and inertia "
        "(relative), com \\[m], joint_position_mm, joint_axis_mrad, grasp_mm, grasp_mrad. Default: "
        "the model is exact.",
    ),
]
PackageOption = Annotated[
    list[str] | None,
    typer.Option(
        "--package",
        metavar="NAME=FOLDER",
        help="Folder of a package that the model's URIs name; may be repeated.",
    ),
]
StartOption = Annotated[
    float | None, typer.Option("--from", metavar="T0", help="First time to use, in seconds.")
]
EndOption = Annotated[
    float | None, typer.Option("--to", metavar="T1", help="Last time to use, in seconds.")
]
LeaveOutBadOption = Annotated[
    bool, typer.Option("--leave-out-bad", help="Leave out and count rows that have a problem.")
]
TopicOption = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="KIND=/NAME",
        help="Topic of a bag that has several of a kind (odometry, pose, imu, joints), or of "
        "thrust; may be repeated.",
    ),
]
ColumnsOption = Annotated[
    str | None,
    typer.Option(
        "--columns",
        metavar="YAML",
        help="Map of the log's columns: names, units and conventions; `cpid telemetry map` writes "
        "one. Default: the columns of models/telemetry/README.md.",
    ),
]
ForceOption = Annotated[
    bool,
    typer.Option(
        "--force",
        help="Replace files of another kind too, and YAML files and models. Inputs are never "
        "replaced.",
    ),
]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Print only warnings and errors.")]


def log_console(quiet: bool = False) -> Console:
    """Return a console for plain text on stderr; long lines are not wrapped."""
    return Console(stderr=True, quiet=quiet, markup=False, highlight=False, soft_wrap=True)


def line_width() -> int | None:
    """Return the width of the terminal; None where the output is a file or a pipe."""
    is_known = sys.stdout.isatty() or "COLUMNS" in os.environ
    return shutil.get_terminal_size().columns if is_known else None


def print_lines(lines: Iterable[str]) -> None:
    """Print lines; those that are longer than the terminal's are broken between words."""
    width = line_width()
    for line in lines:
        if width is None or len(line) <= width:
            print(line)
        else:
            indent = " " * (len(line) - len(line.lstrip()) + 2)
            print(textwrap.fill(line, width, subsequent_indent=indent, break_long_words=False))


def print_warnings(texts: Iterable[str]) -> None:
    """Print warnings on stderr, one line each."""
    for text in texts:
        print(f"warning: {text}", file=sys.stderr)


def check_inputs(
    telemetry: str,
    model: str,
    sensors: str | None,
    columns: str | None = None,
    prior: str | None = None,
) -> None:
    """Refuse inputs that do not exist or are of another kind.

    Raises:
        InputError: for the same reasons as `check_telemetry`, `refuse_unfinished`, `resolve_model`
            and `load_sensors`.

    """
    from cpid_drake.logs.files import check_telemetry

    check_telemetry(telemetry, columns)
    refuse_unfinished(Path(telemetry).parent)
    if "://" not in model or model.startswith(f"package://{MODELS_PACKAGE}/"):
        resolve_model(model)
    if sensors is not None:
        from cpid_drake.sensors.presets import load_sensors

        load_sensors(sensors)
    if prior is not None and not Path(prior).is_file():
        raise InputError(f"--prior {prior}: no such file")


def check_uncertainty(known_bodies: str | None) -> None:
    """Refuse an uncertainty of the spacecraft that cannot be read.

    Raises:
        InputError: for the same reasons as `read_uncertainty`.

    """
    if known_bodies is not None:
        from cpid_drake.dynamics.uncertainty import read_uncertainty

        read_uncertainty(known_bodies)


def check_method(estimator: str | None, rows: str | None, momentum: str, has_sensors: bool) -> None:
    """Check the name of an estimator, and rows and momentum with it.

    Arguments as for `choose_method`.

    Raises:
        InputError: for the same reasons as `choose_method`.

    """
    from cpid_drake.dynamics.total_momentum import TotalMomentum
    from cpid_drake.identification.estimators import choose_method

    choose_method(estimator, rows, TotalMomentum.named(momentum), has_sensors=has_sensors)


def absolute_model(model: str) -> str:
    """Return the absolute path of a model, or its URI unchanged."""
    return model if "://" in model else str(Path(model).expanduser().absolute())


def packages_of(entries: list[str] | None) -> dict[str, str]:
    """Return the folders that --package NAME=FOLDER gives, by name.

    Raises:
        InputError: an entry does not have the form NAME=FOLDER, or the folder does not exist.

    """
    packages = _pairs("--package", entries, "NAME=FOLDER")
    for name, folder in packages.items():
        if not Path(folder).is_dir():
            raise InputError(f"--package {name}={folder}: no such folder: {folder}")
    return {name: str(Path(folder).absolute()) for name, folder in packages.items()}


def topics_of(entries: list[str] | None) -> dict[str, str]:
    """Return the topics that --topic KIND=/NAME gives, by kind.

    Raises:
        InputError: an entry does not have the form KIND=/NAME.

    """
    return _pairs("--topic", entries, "KIND=/NAME, such as imu=/imu/data")


def _pairs(option: str, entries: list[str] | None, form: str) -> dict[str, str]:
    pairs = {}
    for entry in entries or []:
        key, _, value = entry.partition("=")
        if not (key and value):
            raise InputError(f"{option} {entry}: give {form}")
        pairs[key] = value
    return pairs
