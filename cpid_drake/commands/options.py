"""Options that several commands share, and the checks of their values.

The checks import neither Drake nor SciPy: a wrong path or name is reported at once.
"""

import tempfile
from pathlib import Path
from typing import Annotated, TypeVar

import typer
from rich.console import Console

from cpid_drake.errors import InputError
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
        help="Total momentum of spacecraft and target: zero (default), or an unknown constant.",
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
TopicOption = Annotated[
    list[str] | None,
    typer.Option(
        "--topic",
        metavar="KIND=/NAME",
        help="Topic of a bag that has several of a kind (odometry, pose, imu, joints); may be "
        "repeated.",
    ),
]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Print only warnings and errors.")]


def log_console(quiet: bool = False) -> Console:
    """Return a console for plain text on stderr; long lines are not wrapped."""
    return Console(stderr=True, quiet=quiet, markup=False, highlight=False, soft_wrap=True)


def make_folder(path: Path) -> None:
    """Create the folder that --out names.

    Raises:
        InputError: it cannot be created or written to.

    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass  # refuses a read-only folder before the work begins
    except OSError as error:
        raise InputError(f"--out {path}: cannot write there: {error.strerror}") from error


def check_output(option: str, path: Path) -> None:
    """Before the work begins, refuse an output file that cannot be written.

    Raises:
        InputError: the file's folder does not exist, or the path is that of a folder.

    """
    if not path.parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}")
    if path.is_dir():
        raise InputError(f"{option} {path}: is a folder; name a file")


def check_inputs(telemetry: str, model: str, sensors: str | None) -> None:
    """Refuse a log, a model or sensors that do not exist or are of another kind.

    Raises:
        InputError: for the same reasons as `check_telemetry`, `resolve_model` and `load_sensors`.

    """
    from cpid_drake.sensing.files.telemetry_files import check_telemetry

    check_telemetry(telemetry)
    if "://" not in model or model.startswith(f"package://{MODELS_PACKAGE}/"):
        resolve_model(model)
    if sensors is not None:
        from cpid_drake.sensing.presets import load_sensors

        load_sensors(sensors)


def check_method(
    estimator: str | None, rows: str | None, momentum: str, sensors: str | None
) -> None:
    """Refuse an estimator, rows or a momentum that do not exist or cannot be combined.

    Raises:
        InputError: for the same reasons as `choose_method`.

    """
    from cpid_drake.dynamics.total_momentum import TotalMomentum
    from cpid_drake.identification.estimators import choose_method

    choose_method(estimator, rows, TotalMomentum.named(momentum), has_sensors=sensors is not None)


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
