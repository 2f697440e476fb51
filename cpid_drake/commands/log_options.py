"""The options of a log and of its identification: the same for identify, view and report."""

import inspect
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import typer

from cpid_drake.commands import options
from cpid_drake.errors import InputError
from cpid_drake.resources import package_folders, resolve_model

if TYPE_CHECKING:
    from cpid_drake.identification.result import Request

T = TypeVar("T")

_NO_LOGS = ("", ".yaml", ".yml", ".json")
"""Endings of scenarios and results; "" is that of a shipped scenario's name."""

_LOGS = (".csv", ".npz", ".parquet")
"""The most frequent endings of logs."""


@dataclass(frozen=True)
class LogOptions:
    """The values of the options; None and empty values are those that were not given."""

    spacecraft: options.ModelOption[str | None] = None
    base: options.BaseOption[str | None] = None
    capture_frame: options.CaptureFrameOption[str | None] = None
    estimator: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Estimator, such as least_squares, trajectory_fit or recursive_fit; `cpid list` "
            "explains all. Default: trajectory_fit with --sensors or --known-bodies, else "
            "least_squares.",
        ),
    ] = None
    rows: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Row family of least_squares, such as standard, relative or eq18; `cpid list` "
            "explains all. Default: standard, or relative for logs without position and velocity.",
        ),
    ] = None
    sensors: options.SensorsOption = None
    momentum: options.MomentumOption = None
    known_bodies: options.KnownBodiesOption = None
    start: options.StartOption = None
    end: options.EndOption = None
    planar: Annotated[
        bool | None,
        typer.Option(
            "--planar/--no-planar",
            help="Whether the spacecraft floats on a table whose normal is the world's z axis. "
            "Default: yes for logs of x, y and yaw.",
            show_default=False,
        ),
    ] = None
    columns: options.ColumnsOption = None
    package: options.PackageOption = None
    topic: options.TopicOption = None
    prior: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="What is known about the target besides: a result of `cpid identify` (JSON) or "
            "YAML with mass, p_CTcm_C, I_TTcm_C and their σ.",
        ),
    ] = None
    leave_out_bad: options.LeaveOutBadOption = False

    def given(self) -> list[str]:
        """Return the options that were given, with their dashes."""
        names = {"start": "--from", "end": "--to"}
        return [
            names.get(each.name, f"--{each.name.replace('_', '-')}")
            for each in fields(self)
            if getattr(self, each.name) != each.default
        ]

    def files(self) -> list[str | Path]:
        """Return the files that the options name, as far as they exist."""
        given = (self.sensors, self.columns, self.prior)
        found: list[str | Path] = [file for file in given if file]
        if self.known_bodies is not None and "=" not in self.known_bodies:
            found.append(self.known_bodies)
        if self.spacecraft is not None:
            with suppress(InputError):  # `request` reports it
                packages = package_folders(options.packages_of(self.package))
                found.append(resolve_model(self.spacecraft, packages))
        return found

    def is_log(self, source: str) -> bool:
        """Return whether a source is a log: by its ending, or because a spacecraft is given.

        A folder is a log if it is a bag, else a run.
        """
        if Path(source).is_dir():
            return Path(source, "metadata.yaml").is_file()
        if any((self.spacecraft, self.base, self.capture_frame)):
            return True
        ending = Path(source).suffix.lower()
        if ending in (*_NO_LOGS, *_LOGS):  # without the slow import
            return ending in _LOGS
        from cpid_drake.logs.files import telemetry_endings

        return ending in telemetry_endings()

    def request(self, telemetry: str) -> "Request":
        """Return the request to identify a log, after a check of all names.

        The checks before the import of Drake are quick.

        Raises:
            InputError: an option is missing, or a file or a name is wrong.

        """
        craft = (self.spacecraft, self.base, self.capture_frame)
        for option, value in zip(("--spacecraft", "--base", "--capture-frame"), craft):
            if value is None:
                raise InputError(f"{telemetry}: a log needs a spacecraft: give {option}")
        model, base, capture_frame = map(str, craft)
        packages, topics = options.packages_of(self.package), options.topics_of(self.topic)
        model = options.absolute_model(model)
        options.check_inputs(telemetry, model, self.sensors, self.columns, self.prior)
        options.check_uncertainty(self.known_bodies)
        assumed = self.momentum or "zero"
        has_sensors = self.sensors is not None or self.known_bodies is not None
        options.check_method(self.estimator, self.rows, assumed, has_sensors)
        from cpid_drake.identification.result import Request, SpacecraftReference

        return Request(
            telemetry,
            SpacecraftReference(model, base, capture_frame, packages),
            estimator=self.estimator,
            rows=self.rows,
            sensors=self.sensors,
            momentum=self.momentum,
            start=self.start,
            end=self.end,
            topics=topics,
            leave_out_bad=self.leave_out_bad,
            columns=self.columns,
            planar=self.planar,
            known_bodies=self.known_bodies,
            prior=self.prior,
        )

    def applied_to(self, request: "Request") -> "Request":
        """Return the request of a run, with the options that were given in place of its own.

        Raises:
            InputError: an option describes a spacecraft or a log, which a run does itself.

        """
        of_logs = ("--spacecraft", "--base", "--capture-frame", "--package", "--columns", "--topic")
        for option in self.given():
            if option in of_logs:
                raise InputError(f"{option} is for logs; a run has its own spacecraft and columns")
        options.check_uncertainty(self.known_bodies)
        names = ["estimator", "rows", "sensors", "momentum", "known_bodies", "start", "end"]
        names += ["prior", "leave_out_bad"]
        changes = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return replace(request, **changes)


def with_log_options(command: Callable[..., T]) -> Callable[..., T]:
    """Return a command with the options of `LogOptions` in the place of its parameter `log`."""
    hints = get_type_hints(LogOptions, include_extras=True)
    signature = inspect.signature(command)
    parameters: list[inspect.Parameter] = []
    for name, parameter in signature.parameters.items():
        if name != "log":
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        parameters += [
            inspect.Parameter(
                each.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=each.default,
                annotation=hints[each.name],
            )
            for each in fields(LogOptions)
        ]

    def run(**values: Any) -> T:
        log = LogOptions(**{each.name: values.pop(each.name) for each in fields(LogOptions)})
        return command(log=log, **values)

    run.__name__, run.__doc__ = command.__name__, command.__doc__
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return run
