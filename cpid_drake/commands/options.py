"""Options that several commands share, each declared once.

The heavy names are those of `cpid_drake` itself, which imports them when they are first used: help
does not wait for Drake.
"""

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number as Within
from rich.console import Console

import cpid_drake as cpid
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import find_scenario, from_folder
from cpid_drake.identification.description import describe
from cpid_drake.identification.request import sensors_by_log

if TYPE_CHECKING:
    FileName = str
else:
    FileName = str | Path  # the values are str, which is tried first; shells complete paths

NOT_ALL_KNOWN, CHECK_FAILED = 3, 4
"""Exit codes: something is not identifiable; something contradicts the assumptions behind it."""

File = Annotated[Path, Parameter(metavar="FILE")]
Folder = Annotated[Path, Parameter(metavar="FOLDER")]
Name = Annotated[str, Parameter(metavar="NAME")]
Sensors = Annotated[FileName, Parameter(metavar="PRESET|YAML")]
LiveSensors = Annotated[
    Sensors,
    Parameter(
        help="Sensor noise: a preset or a YAML file. Default: that of the spacecraft's file."
    ),
]
Seconds = Annotated[float, Parameter(metavar="SECONDS")]
Number = Annotated[float, Parameter(metavar="NUMBER")]
Count = Annotated[int, Parameter(metavar="COUNT")]
Rate = Annotated[float, Parameter(metavar="HZ", validator=Within(gte=1e-6, lte=1e6))]

Scenario = Annotated[
    FileName, Parameter(help="A scenario file, or the name of a shipped scenario.")
]
LogFile = Annotated[FileName, Parameter(help="CSV, Parquet or ROS bag; A+B: files of one log.")]
Result = Annotated[Path, Parameter(help="Result file of `cpid identify --json`.")]
OutFolder = Annotated[
    Path, Parameter(metavar="FOLDER", help="Folder to write; created if it is not there.")
]
Force = Annotated[bool, Parameter(help="Replace files that exist. Inputs are never replaced.")]
Quiet = Annotated[bool, Parameter(help="Print only warnings and errors.")]
Host = Annotated[
    str,
    Parameter(
        metavar="ADDRESS",
        help="Address on which the page is served: 127.0.0.1 for this computer alone, 0.0.0.0 for "
        "all of its networks.",
    ),
]
Show = Annotated[
    bool,
    Parameter(negative="--no-show", help="Show estimate, residuals and scene on a page."),
]
Wait = Annotated[bool, Parameter(help="Keep the page open after the end, until Enter or Ctrl-C.")]
Columns = Annotated[
    FileName,
    Parameter(
        metavar="YAML",
        help="Map of the log's columns: names, units and conventions; `cpid log map` writes one. "
        "Default: the columns of models/telemetry/README.md.",
    ),
]
LeaveOutBad = Annotated[bool, Parameter(help="Leave out and count rows that have a problem.")]
Topics = Annotated[
    list[str],
    Parameter(
        metavar="KIND=/NAME",
        help="Topic of a kind (odometry, pose, imu, joints, thrust); may be repeated. A bag needs "
        "it for thrust and for kinds with several topics. Of transforms with the frames of world "
        "and base, pose=/tf:WORLD:BASE; of joints in a bag several, joints=/arm,/wheels.",
    ),
]
Momentum = Annotated[
    Literal["zero", "unknown"],
    Parameter(
        metavar="zero|unknown",
        show_choices=False,
        help="Total momentum of spacecraft and target: zero, or an unknown constant. Default: "
        "zero; of a log that contradicts that, unknown.",
    ),
]


@Parameter("*")
@dataclass(frozen=True)
class SpacecraftOptions:
    """The spacecraft model."""

    spacecraft: Annotated[FileName | None, Parameter(metavar="YAML|SCENARIO")] = None
    """File of a spacecraft, or a scenario, with model, base, capture frame, packages, sensors,
    momentum, table and uncertainty of the spacecraft model; other options override it."""
    model: Annotated[FileName | None, Parameter(metavar="MODEL")] = None
    """The spacecraft's model file: URDF, SDF, MJCF or Drake directives."""
    base: Name | None = None
    """Base body of the spacecraft."""
    capture_frame: Name | None = None
    """Frame or link of the model that holds the target."""
    package: Annotated[list[str] | None, Parameter(metavar="NAME=FOLDER")] = None
    """Folder of a package that the model's URIs name; may be repeated."""
    repair_bodies: Annotated[
        Literal["nearest"] | None, Parameter(metavar="nearest", show_choices=False)
    ] = None
    """Take the nearest body that can be in the place of one that cannot. Default: refuse it."""

    def spacecraft_file(self) -> "cpid.SpacecraftFile":
        """Return what is known of the spacecraft from the file and the single options.

        Raises:
            InputError: the model, its base or its capture frame is missing, or the file is wrong.

        """
        here, packages = Path.cwd(), packages_of(self.package)
        names = {"base": self.base, "capture_frame": self.capture_frame}
        names["model"] = self.model and from_folder(here, self.model)
        given: dict[str, Any] = {key: name for key, name in names.items() if name}
        is_whole = len(given) == len(names)
        if self.repair_bodies is not None:
            given["repair_bodies"] = self.repair_bodies
        if self.spacecraft is not None:
            file = cpid.load_spacecraft(self.spacecraft)
            return replace(file, **given, packages={**file.packages, **packages})
        if not is_whole:
            raise InputError(
                "a log needs a spacecraft: give --spacecraft, or all of --model, --base and "
                "--capture-frame"
            )
        return cpid.SpacecraftFile(**given, packages=packages)

    def files(self) -> list[str | Path]:
        """Return the file of the spacecraft, if there is one."""
        return [] if self.spacecraft is None else [find_scenario(self.spacecraft)]


@dataclass(frozen=True)
class KnownOptions(SpacecraftOptions):
    """What is known besides the samples."""

    momentum: Momentum | None = None
    known_bodies: Annotated[FileName | None, Parameter(metavar="KEY=NUMBER,...|YAML|exact")] = None
    """Uncertainty of the spacecraft, 1 sigma, that the intervals include: mass and inertia
    (relative), com [m], joint_position_mm, joint_axis_mrad, grasp_mm, grasp_mrad. Default:
    mass=0.01,com=0.005,inertia=0.01, but exact if the sensors' file says `unstated: exact`."""
    planar: Annotated[bool | None, Parameter(negative="--no-planar")] = None
    """Whether the spacecraft floats on a table whose normal is the world's z axis. Default: yes for
    logs of x, y and yaw."""
    prior: Annotated[FileName | None, Parameter(metavar="FILE")] = None
    """What is known about the target besides: a result of `cpid identify` (JSON) or YAML with mass,
    p_CTcm_C, I_TTcm_C and their σ."""

    def request_of(self, telemetry: str, sensors: str | None, **others: Any) -> "cpid.Request":
        """Return a request: what the options say, else what the file of the spacecraft says.

        Raises:
            InputError: an option is missing, or a file or a name is wrong.

        """
        names = ("momentum", "known_bodies", "planar", "prior")
        given = {name: getattr(self, name) for name in names}
        return cpid.Request.of(self.spacecraft_file(), telemetry, sensors, **given, **others)


@Parameter("*")
@dataclass(frozen=True)
class PartOptions:
    """How to read a log, and which part of it to use."""

    columns: Columns | None = None
    topic: Topics | None = None
    leave_out_bad: LeaveOutBad = False
    start: Annotated[Seconds | None, Parameter("--from")] = None
    """First time to use."""
    end: Annotated[Seconds | None, Parameter("--to")] = None
    """Last time to use."""

    def reading(self) -> dict[str, Any]:
        """Return the fields of a request of the same meaning."""
        names = ("columns", "leave_out_bad", "start", "end")
        return {name: getattr(self, name) for name in names} | {"topics": topics_of(self.topic)}


@dataclass(frozen=True)
class LogOptions(PartOptions, KnownOptions):
    """The options of a log and of its identification."""

    estimator: Name | None = None
    """Estimator, such as least_squares, trajectory_fit or recursive_fit; `cpid list` explains all.
    Default: trajectory_fit; least_squares with --rows, without attitude, and for a simulation's
    exact states without --sensors or --known-bodies: their momentum is constant to a
    hundred-thousandth."""
    rows: Name | None = None
    """Row family of least_squares, such as standard, relative or eq18; `cpid list` explains all.
    Default: standard, or relative for logs without position and velocity."""
    sensors: Annotated[list[FileName] | None, Parameter(metavar="[NAME=]PRESET|YAML")] = None
    """Sensor noise: a preset or a YAML file. NAME= before it, the name of a log, gives those of
    this log alone, and may be repeated; logs with the same file have the same hardware. Default:
    estimated from the log if needed."""

    def request(self, log: str, logs: Sequence[str] = ()) -> "cpid.Request":
        """Return the request to identify a log, of `logs` if several are identified together.

        Raises:
            InputError: as for `request_of`.

        """
        logs = logs or [log]
        sensors = sensors_by_log(self.sensors or [], logs)[logs.index(log)]
        method = {"estimator": self.estimator, "rows": self.rows}
        return self.request_of(log, sensors, **method, **self.reading())

    def of_run(self, folder: Path) -> "LogOptions":
        """Return the options with those of a run of `cpid simulate` where none are given."""
        suite = folder / "sensors.yaml"
        sensors = self.sensors or ([str(suite)] if suite.is_file() else None)
        return replace(self, spacecraft=str(folder / "scenario.yaml"), sensors=sensors)


def topics_of(entries: list[str] | None) -> dict[str, str]:
    """Return the topics by kind; InputError without the form KIND=/NAME."""
    return _pairs("--topic", entries, "KIND=/NAME, such as imu=/imu/data")


def packages_of(entries: list[str] | None) -> dict[str, str]:
    """Return the folders of packages by name; InputError without the form NAME=FOLDER."""
    folders = _pairs("--package", entries, "NAME=FOLDER")
    return {name: from_folder(Path.cwd(), folder) for name, folder in folders.items()}


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Say how to install the package of an optional part that cannot be imported inside."""
    try:
        yield
    except ImportError as error:
        raise InputError(
            f"this command needs {error.name}: `pip install 'cpid-drake[{name}]'`"
        ) from error


def log_console(quiet: bool = False, *, stderr: bool = True) -> Console:
    """Return a console for plain text, of stderr or stdout; long lines are not wrapped."""
    return Console(stderr=stderr, quiet=quiet, markup=False, highlight=False, soft_wrap=True)


def finish(answer: "cpid.Identification", quiet: bool) -> int:
    """Print an identification and its warnings, and return the exit code of its command."""
    print_warnings(answer.warnings)
    if quiet:
        print_warnings(f"failed check: {failure}" for failure in answer.failures)
    else:
        print("\n".join(describe(answer)))
    if answer.failures:
        return CHECK_FAILED
    return 0 if answer.is_complete else NOT_ALL_KNOWN


def print_warnings(texts: Iterable[str]) -> None:
    """Print warnings on stderr, one line each."""
    for text in texts:
        print(f"warning: {text}", file=sys.stderr)


def _pairs(option: str, entries: list[str] | None, form: str) -> dict[str, str]:
    pairs = {}
    for entry in entries or []:
        key, _, value = entry.partition("=")
        if not (key and value):
            raise InputError(f"{option} {entry}: give {form}")
        pairs[key] = value
    return pairs
