"""The request of `cpid identify`, as a result file records it."""

import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from cpid_drake.files.errors import InputError
from cpid_drake.files.resources import package_folders, resolve_model
from cpid_drake.logs.joined import log_name, log_parts
from cpid_drake.spacecraft.reference import SpacecraftReference
from cpid_drake.spacecraft.spacecraft_file import EXPLICIT, SpacecraftFile

_OPTIONS = {
    "packages": "package",
    "start": "from",
    "end": "to",
    "topics": "topic",
}
"""Options of `cpid identify` that have another name than their fields."""


def log_names(paths: Sequence[str]) -> list[str]:
    """Return the names of logs in results: of their files, or their paths if names are equal."""
    short = [log_name(path) for path in paths]
    return short if len(set(short)) == len(short) else list(paths)


def sensors_by_log(entries: Sequence[str], logs: Sequence[str]) -> list[str | None]:
    """Return the sensors of each log from entries FILE, for all logs, and NAME=FILE, for one.

    Raises:
        InputError: there is no log of a name, or two entries are for the same logs.

    """
    own: dict[str, str] = {}
    names = log_names(logs)
    for entry in entries:
        name = next((each for each in names if entry.startswith(f"{each}=")), "")
        file = entry.removeprefix(f"{name}=") if name else entry
        if "=" in file and not name and not Path(file).exists():
            wanted = entry.partition("=")[0]
            raise InputError(
                f"--sensors {entry}: there is no log {wanted}; the logs are {', '.join(names)}"
            )
        if name in own or not file:
            raise InputError(
                f"--sensors {entry}: give one PRESET or YAML for all logs, and one NAME=PRESET or "
                "NAME=YAML for a log with others"
            )
        own[name] = file
    return [own.get(name) or own.get("") for name in names]


@dataclass(frozen=True)
class Request:
    """The request of `cpid identify`: data, spacecraft, estimator and options of one log.

    Attributes:
        telemetry: a file or a bag's folder, or several with "+" between them; see `inspect_log`.
        spacecraft: the spacecraft model.
        estimator, rows: see `cpid_drake.identification.identify.identify`.
        sensors: name of a preset or a YAML file; None if they are unknown. Logs with the same have
            the same hardware.
        momentum: name of the total momentum, see `TotalMomentum.named`; None to test whether it is
            zero, and to estimate it if it is not.
        start, end: first and last time to use [s]; None for all.
        topics: topics of a bag, by kind.
        leave_out_bad: whether to leave out rows that have a problem.
        columns: the YAML file of a map of the telemetry's columns; None for the package's own.
        planar: whether a table carries the spacecraft; None to recognize logs of x, y and yaw.
        known_bodies: uncertainty of the spacecraft, see `arguments.read_uncertainty`; None if
            the spacecraft is known exactly.
        prior: the file of a prior of the target; None without one.

    """

    telemetry: str
    spacecraft: SpacecraftReference
    estimator: str | None = None
    rows: str | None = None
    sensors: str | None = None
    momentum: str | None = None
    start: float | None = None
    end: float | None = None
    topics: Mapping[str, str] = field(default_factory=dict)
    leave_out_bad: bool = False
    columns: str | None = None
    planar: bool | None = None
    known_bodies: str | None = None
    prior: str | None = None

    @classmethod
    def of(
        cls, spacecraft: SpacecraftFile, telemetry: str, sensors: str | None = None, **given: Any
    ) -> Self:
        """Return the request to identify a log: what is given, else what a spacecraft's file says.

        Args:
            spacecraft: the file's contents.
            telemetry: the log's file.
            sensors: a preset or a file.
            **given: other fields of `Request`; None for what the file says.

        Raises:
            InputError: the file lists its sensors itself, and no others are given.

        """
        sensors = sensors or spacecraft.sensors
        if sensors == EXPLICIT:
            raise InputError(
                "the scenario lists its sensors itself; write them into a file of their own, and "
                "give it as --sensors"
            )
        fields: dict[str, Any] = {"momentum": spacecraft.momentum, "planar": spacecraft.planar}
        if not spacecraft.known_bodies.is_zero:
            pairs = vars(spacecraft.known_bodies).items()
            fields["known_bodies"] = ",".join(f"{key}={value}" for key, value in pairs)
        fields |= {key: value for key, value in given.items() if value is not None}
        return cls(telemetry, spacecraft.reference(), sensors=sensors, **fields)

    def files(self) -> dict[str, str]:
        """Return the files with hashes in results, by their fields."""
        files = {"telemetry": self.telemetry, "columns": self.columns, "prior": self.prior}
        return {option: name for option, name in files.items() if name is not None}

    def existing_files(self) -> list[Path]:
        """Return the files that the request names, as far as they exist."""
        names = (self.spacecraft.model, self.sensors, self.known_bodies, *self.files().values())
        paths = list[Path]()
        packages = package_folders(self.spacecraft.packages)
        for name in filter(None, names):
            for part in log_parts(name) if name == self.telemetry else (name,):
                with suppress(InputError):  # a preset, or a file that was moved
                    paths.append(resolve_model(part, packages))
        return paths

    def command(self, others: "Sequence[Request]" = ()) -> str:
        """Return the command line of this request, with those of other logs of the same target."""
        logs = [each.telemetry for each in (self, *others)]
        words = ["cpid", "identify", *logs]
        options = {**vars(self.spacecraft), **vars(self)}
        del options["telemetry"], options["spacecraft"]
        for name, each in zip(log_names(logs)[1:], others, strict=True):
            if each.sensors != self.sensors:
                words += ["--sensors", f"{name}={each.sensors}"]
        for name, value in options.items():
            option = f"--{_OPTIONS.get(name, name).replace('_', '-')}"
            if isinstance(value, Mapping):
                words += [each for pair in value.items() for each in (option, "=".join(pair))]
            elif isinstance(value, bool):
                words += [option] if value else [f"--no-{name}"] if name == "planar" else []
            elif value is not None:
                words += [option, str(value)]
        return shlex.join(words)


@dataclass(frozen=True)
class Source:
    """A log of a result.

    Attributes:
        request: the request for this log.
        sha256: hashes of `Request.files`; None for a folder.
        start, end: first and last time that was used [s].
        cpid_drake: version of this package; empty if it was not installed.

    """

    request: Request
    sha256: dict[str, str | None]
    start: float
    end: float
    cpid_drake: str
