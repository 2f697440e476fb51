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
from cpid_drake.files.drafts import refuse_unfinished
from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import find_scenario, package_folders, resolve_model
from cpid_drake.identification.arguments import EXACT_MODEL
from cpid_drake.identification.description import describe
from cpid_drake.identification.request import log_names
from cpid_drake.simulation.spacecraft_file import EXPLICIT, SpacecraftFile, load_spacecraft

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    FileName = str
else:
    FileName = str | Path  # the values are str, which is tried first; shells complete paths

NOT_ALL_KNOWN = 3
"""Exit code if not all parameters that can act on the motion are identifiable."""

CHECK_FAILED = 4
"""Exit code if something contradicts the assumptions behind the answer."""

_AS_THEY_ARE = ("estimator", "rows", "start", "end", "leave_out_bad", "columns")
"""Options that are fields of a request of the same name and value."""

File = Annotated[Path, Parameter(metavar="FILE")]
Folder = Annotated[Path, Parameter(metavar="FOLDER")]
Name = Annotated[str, Parameter(metavar="NAME")]
Yaml = Annotated[FileName, Parameter(metavar="YAML")]
Sensors = Annotated[FileName, Parameter(metavar="PRESET|YAML")]
Seconds = Annotated[float, Parameter(metavar="SECONDS")]
Number = Annotated[float, Parameter(metavar="NUMBER")]
Count = Annotated[int, Parameter(metavar="COUNT")]
Rate = Annotated[float, Parameter(metavar="HZ", validator=Within(gte=1e-6, lte=1e6))]

Scenario = Annotated[
    FileName, Parameter(help="A scenario file, or the name of a shipped scenario.")
]
LogFile = Annotated[FileName, Parameter(help="CSV, NPZ, Parquet or ROS 2 bag.")]
Result = Annotated[Path, Parameter(help="Result file of `cpid identify --json`.")]
OutFolder = Annotated[
    Path, Parameter(metavar="FOLDER", help="Folder to write; created if it is not there.")
]
Force = Annotated[bool, Parameter(help="Replace files that exist. Inputs are never replaced.")]
Quiet = Annotated[bool, Parameter(help="Print only warnings and errors.")]
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

    scenario: Annotated[FileName | None, Parameter(metavar="SCENARIO|YAML")] = None
    """Scenario, or file of a spacecraft, with model, base, capture frame, packages, sensors,
    momentum, table and uncertainty of the spacecraft model; other options override it."""
    spacecraft: Annotated[FileName | None, Parameter(metavar="MODEL")] = None
    """The spacecraft's model file: URDF, SDF, MJCF or Drake directives."""
    base: Name | None = None
    """Base body of the spacecraft."""
    capture_frame: Name | None = None
    """Frame or link of the model that holds the target."""
    package: Annotated[list[str] | None, Parameter(metavar="NAME=FOLDER")] = None
    """Folder of a package that the model's URIs name; may be repeated."""

    def known(self) -> SpacecraftFile:
        """Return what is known of the spacecraft from the file and the single options.

        Raises:
            InputError: the model, its base or its capture frame is missing, or the file is wrong.

        """
        names = {"model": self.spacecraft, "base": self.base, "capture_frame": self.capture_frame}
        given: dict[str, Any] = {key: name for key, name in names.items() if name}
        packages = _pairs("--package", self.package, "NAME=FOLDER")
        if self.scenario is not None:
            found = load_spacecraft(self.scenario)
            found = replace(found, **given, packages={**found.packages, **packages})
        elif len(given) == len(names):
            found = SpacecraftFile(**given, packages=packages)
        else:
            raise InputError(
                "a log needs a spacecraft: give --scenario, or all of --spacecraft, --base and "
                "--capture-frame"
            )
        folders = {name: _absolute(folder) for name, folder in found.packages.items()}
        return replace(found, model=_absolute(found.model), packages=folders)

    def files(self) -> list[str | Path]:
        """Return the files that the options name."""
        if (self.scenario, self.spacecraft) == (None, None):
            return []
        found = self.known()
        scenario = [] if self.scenario is None else [find_scenario(self.scenario)]
        return [*scenario, resolve_model(found.model, package_folders(found.packages))]


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

    def make_request(self, telemetry: str, sensors: str | None, **others: Any) -> "cpid.Request":
        """Return a request: what the options say, else what the file of the spacecraft says.

        Raises:
            InputError: an option is missing, or a file or a name is wrong.

        """
        known = self.known()
        sensors = sensors or known.sensors
        if sensors == EXPLICIT:
            raise InputError(
                f"{self.scenario}: lists its sensors itself; write them into a file of their own, "
                "and give it as --sensors"
            )
        bodies = ",".join(f"{key}={value}" for key, value in vars(known.known_bodies).items())
        return cpid.Request(
            telemetry,
            known.reference(),
            sensors=sensors,
            momentum=self.momentum or known.momentum,
            planar=known.planar if self.planar is None else self.planar,
            known_bodies=self.known_bodies or (None if known.known_bodies.is_zero else bodies),
            prior=self.prior,
            **others,
        )


@dataclass(frozen=True)
class LiveOptions(KnownOptions):
    """What is known before samples arrive, and their topics."""

    sensors: Sensors | None = None
    """Sensor noise: a preset or a YAML file. Default: that of the scenario."""
    topic: Topics | None = None

    def topics(self) -> dict[str, str]:
        """Return the topics by kind; see `ReadingOptions.topics`. Joints have a default."""
        return {"joints": "/joint_states"} | _pairs("--topic", self.topic, "KIND=/NAME")


@Parameter("*")
@dataclass(frozen=True)
class ReadingOptions:
    """How to read a log."""

    columns: Yaml | None = None
    """Map of the log's columns: names, units and conventions; `cpid log map` writes one. Default:
    the columns of models/telemetry/README.md."""
    topic: Topics | None = None

    def topics(self) -> dict[str, str]:
        """Return the topics by kind; InputError without the form KIND=/NAME."""
        return _pairs("--topic", self.topic, "KIND=/NAME, such as imu=/imu/data")


@dataclass(frozen=True)
class PartOptions(ReadingOptions):
    """How to read a log, and which part of it to use."""

    leave_out_bad: LeaveOutBad = False
    start: Annotated[Seconds | None, Parameter("--from")] = None
    """First time to use."""
    end: Annotated[Seconds | None, Parameter("--to")] = None
    """Last time to use."""


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

    def files(self) -> list[str | Path]:
        """Return the files that the options name."""
        bodies = self.known_bodies or EXACT_MODEL
        of_bodies = None if "=" in bodies or bodies == EXACT_MODEL else bodies
        sensors = [file for each in self.sensors or [] for file in (each, each.rpartition("=")[2])]
        given = (*sensors, self.columns, self.prior, of_bodies)
        return [*super().files(), *(file for file in given if file)]

    def request(self, log: str, logs: Sequence[str] = ()) -> "cpid.Request":
        """Return the request to identify a log, of `logs` if several are identified together.

        Raises:
            InputError: as for `make_request`; the log is unfinished.

        """
        refuse_unfinished(Path(log).parent)
        logs = logs or [log]
        own = _sensors_of(self.sensors or [], names := log_names(logs))
        sensors = own.get(names[logs.index(log)]) or own.get("")
        others = {name: getattr(self, name) for name in _AS_THEY_ARE}
        return self.make_request(log, sensors, topics=self.topics(), **others)

    def of_run(self, folder: Path) -> "LogOptions":
        """Return the options with those of a run of `cpid simulate` where none are given."""
        suite = folder / "sensors.yaml"
        sensors = self.sensors or ([str(suite)] if suite.is_file() else None)
        return replace(self, scenario=str(folder / "scenario.yaml"), sensors=sensors)


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Say how to install the package of an optional part that cannot be imported inside."""
    try:
        yield
    except ImportError as error:
        raise InputError(
            f"this command needs {error.name}: `pip install 'cpid-drake[{name}]'`"
        ) from error


def open_meshcat(remark: str = "") -> "Meshcat":
    """Return a new Meshcat, and print the address of its page.

    Raises:
        InputError: no port is free.

    """
    from pydrake.geometry import Meshcat, MeshcatParams

    try:
        meshcat = Meshcat(MeshcatParams(host="*"))
    except RuntimeError as error:
        raise InputError(f"Meshcat cannot be opened: {error}") from error
    print(f"Open {meshcat.web_url()}{remark}", file=sys.stderr, flush=True)
    return meshcat


def log_console(quiet: bool = False, *, stderr: bool = True) -> Console:
    """Return a console for plain text, of stderr or stdout; long lines are not wrapped."""
    return Console(stderr=stderr, quiet=quiet, markup=False, highlight=False, soft_wrap=True)


def finish(found: "cpid.Identification", quiet: bool) -> int:
    """Print an identification and its warnings, and return the exit code of its command."""
    print_warnings(found.warnings)
    if quiet:
        print_warnings(f"failed check: {failure}" for failure in found.failures)
    else:
        print("\n".join(describe(found)))
    if found.failures:
        return CHECK_FAILED
    return 0 if found.is_complete else NOT_ALL_KNOWN


def print_warnings(texts: Iterable[str]) -> None:
    """Print warnings on stderr, one line each."""
    for text in texts:
        print(f"warning: {text}", file=sys.stderr)


def _sensors_of(entries: Sequence[str], logs: Sequence[str]) -> dict[str, str]:
    """Return the given sensors by the names of logs, and under "" those of all others."""
    own: dict[str, str] = {}
    for entry in entries:
        name = next((each for each in logs if entry.startswith(f"{each}=")), "")
        file = entry[len(name) + 1 :] if name else entry
        if "=" in file and not name and not Path(file).exists():
            wanted = entry.partition("=")[0]
            raise InputError(
                f"--sensors {entry}: there is no log {wanted}; the logs are {', '.join(logs)}"
            )
        if name in own or not file:
            raise InputError(
                f"--sensors {entry}: give one PRESET or YAML for all logs, and one NAME=PRESET or "
                "NAME=YAML for a log with others"
            )
        own[name] = file
    return own


def _absolute(path: str) -> str:
    """Return the absolute path of a file or folder, or its URI unchanged."""
    return path if "://" in path else str(Path(path).expanduser().absolute())


def _pairs(option: str, entries: list[str] | None, form: str) -> dict[str, str]:
    pairs = {}
    for entry in entries or []:
        key, _, value = entry.partition("=")
        if not (key and value):
            raise InputError(f"{option} {entry}: give {form}")
        pairs[key] = value
    return pairs
