"""The joint motions of scenarios, and joint motions in files of their own."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.joint_motion import SPLINE_DEGREE, HalfCosine, MultiSine, Spline
from cpid_drake.files.checked_yaml import load_yaml
from cpid_drake.files.constraints import FirstUnlessTagged, Limits, Numbers
from cpid_drake.files.drafts import draft_of
from cpid_drake.files.dumping import dump_yaml
from cpid_drake.files.errors import InputError, choose_from, prefix_errors
from cpid_drake.files.resources import resolve_model
from cpid_drake.spacecraft.spacecraft import Spacecraft

Entries = Annotated[Array, Numbers()]
Configuration = Mapping[str, float]


@dataclass
class HalfCosineMotion:
    """Half-cosine motion between two configurations [rad or m by joint name], T = duration [s].

    Joints that a configuration does not name have their positions in
    `SpacecraftConfig.configuration`.
    """

    duration: Annotated[float, Limits(gt=0)] = 10.0
    initial: dict[str, float] = field(default_factory=dict)
    final: dict[str, float] = field(default_factory=dict)

    def make(self, spacecraft: Spacecraft, default: Configuration) -> HalfCosine:
        """Return the motion of the spacecraft's joints; errors: see `Scenario.make_joint_motion`.

        Args:
            spacecraft: the spacecraft model.
            default: positions of joints that the motion does not name [rad or m by joint name].

        """
        return HalfCosine(
            spacecraft.configuration({**default, **self.initial}, "joint_motion.initial"),
            spacecraft.configuration({**default, **self.final}, "joint_motion.final"),
            self.duration,
        )


@dataclass
class MultiSineMotion:
    """Sums of sines about a configuration, tagged `!MultiSineMotion` in YAML.

    `centre` [rad or m], `amplitudes` [rad or m] and `phases` [rad] are by joint name; the latter
    two are lists with one entry for each of the frequencies [Hz]. A joint that is not named has
    its centre from `SpacecraftConfig.configuration`, and zero amplitudes and phases. The amplitudes
    rise from zero over the first `ramp` [s] and fall to zero over the last. Joints in `final` [rad
    or m] move from their centre to this position during the motion; the others end at the centre.
    """

    yaml_tag: ClassVar = "!MultiSineMotion"
    duration: Annotated[float, Limits(gt=0)] = 10.0
    ramp: float = 2.0
    frequencies: Entries = field(default_factory=lambda: np.zeros(0))
    centre: dict[str, float] = field(default_factory=dict)
    amplitudes: dict[str, Entries] = field(default_factory=dict)
    phases: dict[str, Entries] = field(default_factory=dict)
    final: dict[str, float] = field(default_factory=dict)

    def make(self, spacecraft: Spacecraft, default: Configuration) -> MultiSine:
        """Return the motion of this spacecraft's joints; see `HalfCosineMotion.make`."""
        centre = {**default, **self.centre}
        start = spacecraft.configuration(centre, "joint_motion.centre")
        end = spacecraft.configuration({**centre, **self.final}, "joint_motion.final")
        still, count = np.zeros(len(spacecraft.joint_names)), np.size(self.frequencies)
        each = f"one for each of the {count} frequencies"
        return MultiSine(
            centre=start,
            amplitudes=_table(spacecraft, self.amplitudes, "amplitudes", still, count, each),
            frequencies=self.frequencies,
            phases=_table(spacecraft, self.phases, "phases", still, count, each),
            ramp=self.ramp,
            duration=self.duration,
            displacement=end - start,
        )


@dataclass
class SplineMotion:
    """Splines of degree 5, tagged `!SplineMotion` in YAML; see `dynamics.joint_motion.Spline`.

    `coefficients` are those of each joint [rad or m by joint name], equally many for all joints. A
    joint that is not named keeps its position in `SpacecraftConfig.configuration`.
    """

    yaml_tag: ClassVar = "!SplineMotion"
    duration: Annotated[float, Limits(gt=0)] = 10.0
    coefficients: dict[str, Entries] = field(default_factory=dict)

    def make(self, spacecraft: Spacecraft, default: Configuration) -> Spline:
        """Return the motion of this spacecraft's joints; see `HalfCosineMotion.make`."""
        still = spacecraft.configuration(default, "spacecraft.configuration")
        first = next(iter(self.coefficients), "")
        count = np.size(self.coefficients[first]) if first else SPLINE_DEGREE + 1
        each = f"as many as {first}, {count}"
        table = _table(spacecraft, self.coefficients, "coefficients", still, count, each)
        return Spline(table, self.duration)


def _table(
    spacecraft: Spacecraft,
    entries: dict[str, Array],
    key: str,
    still: Array,
    count: int,
    each: str,
) -> Array:
    """Return entries by joint as (count, J); `still` (J,) for joints without entries."""
    names = spacecraft.joint_names
    table = np.tile(still, (count, 1))
    for name, values in entries.items():
        if name not in names:
            raise InputError(f"joint_motion.{key}: no joint '{name}'; {choose_from(name, names)}")
        if np.shape(values) != (count,) or not np.isfinite(values).all():
            raise InputError(f"joint_motion.{key}: {name} needs finite numbers, {each}")
        table[:, names.index(name)] = values
    return table


@dataclass
class MotionFile:
    """The joint motion in a file, tagged `!MotionFile` in YAML; see `load_motion`.

    `file` is a package:// URI or a path relative to the scenario's folder.
    """

    yaml_tag: ClassVar = "!MotionFile"
    file: Annotated[str, Limits(min_length=1)]

    def make(self, spacecraft: Spacecraft, default: Configuration) -> "AnyMotion":
        """Return the motion of this spacecraft's joints; see `HalfCosineMotion.make`.

        Raises:
            InputError: for the same reasons as `load_motion` and the motion in the file.

        """
        with prefix_errors(self.file):
            return load_motion(self.file).make(spacecraft, default)


AnyMotion = HalfCosine | MultiSine | Spline
"""A joint motion of a scenario."""

MotionSchema = HalfCosineMotion | MultiSineMotion | SplineMotion
"""The declaration of a joint motion in a file."""


@dataclass
class MotionDocument:
    """A file with a joint motion alone, under the key that it has in a scenario."""

    joint_motion: Annotated[MotionSchema, FirstUnlessTagged()]


def load_motion(path: str | Path) -> MotionSchema:
    """Read a joint motion from a YAML file with the key `joint_motion`.

    Raises:
        InputError: no such file, not YAML, unknown keys, or values of the wrong type or size.

    """
    file = resolve_model(path)
    return load_yaml(MotionDocument, file, str(path), "a joint motion").joint_motion


def dump_motion(motion: MotionSchema) -> str:
    """Return a joint motion as YAML; `load_motion` reads it without loss."""
    return dump_yaml(MotionDocument(motion))


def write_joint_table(
    path: str | Path, motion: AnyMotion, joint_names: Sequence[str], rate: float
) -> None:
    """Write time, positions, rates and accelerations of all joints as CSV, at a rate [Hz].

    Raises:
        InputError: the file cannot be written.

    """
    times = np.linspace(0.0, motion.duration, math.ceil(motion.duration * rate - 1e-9) + 1)
    names = [f"{quantity}:{joint}" for quantity in ("q", "qd", "qdd") for joint in joint_names]
    table = np.column_stack([times, motion.evaluate(times).reshape(len(times), -1)])
    with draft_of(path) as draft:
        np.savetxt(draft, table, "%.12g", ",", header=",".join(["time", *names]), comments="")
