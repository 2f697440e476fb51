"""The joint motions of scenarios."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

import numpy as np
from annotated_types import Gt
from numpy.typing import NDArray

from cpid_drake.dynamics.joint_motion import HalfCosine, MultiSine
from cpid_drake.errors import InputError, choose_from
from cpid_drake.input_files.validation import Numbers

if TYPE_CHECKING:  # it imports Drake, which reading a scenario does not need
    from cpid_drake.spacecraft.spacecraft import Spacecraft

SHORTEST_RAMP = 1e-3
"""Shortest duration of a motion [s]; a shorter one would need excessive accelerations."""

Array = Annotated[NDArray[np.float64], Numbers()]
Configuration = Mapping[str, float]


@dataclass
class HalfCosineMotion:
    """Half-cosine motion between two configurations [rad or m by joint name], T = duration [s].

    Joints that a configuration does not name have their positions in
    `SpacecraftConfig.configuration`.
    """

    duration: Annotated[float, Gt(0)] = 10.0
    initial: dict[str, float] = field(default_factory=dict)
    final: dict[str, float] = field(default_factory=dict)

    def make(self, spacecraft: "Spacecraft", default: Configuration) -> HalfCosine:
        """Return the motion of the spacecraft's joints; errors: see `Scenario.make_joint_motion`.

        Args:
            spacecraft: the known spacecraft.
            default: positions of joints that the motion does not name [rad or m by joint name].

        """
        motion = HalfCosine(
            spacecraft.configuration({**default, **self.initial}, "joint_motion.initial"),
            spacecraft.configuration({**default, **self.final}, "joint_motion.final"),
            self.duration,
        )
        _check_rates(motion, spacecraft, "give a longer duration")
        return motion


@dataclass
class MultiSineMotion:
    """Sums of sines about a configuration, tagged `!MultiSineMotion` in YAML.

    `centre` [rad or m], `amplitudes` [rad or m] and `phases` [rad] are by joint name; the latter
    two are lists with one entry for each of the frequencies [Hz]. A joint that is not named has
    its centre from `SpacecraftConfig.configuration`, and zero amplitudes and phases. The amplitudes
    rise from zero over the first `ramp` [s] and fall to zero over the last.
    """

    duration: Annotated[float, Gt(0)] = 10.0
    ramp: float = 2.0
    frequencies: Array = field(default_factory=lambda: np.zeros(0))
    centre: dict[str, float] = field(default_factory=dict)
    amplitudes: dict[str, Array] = field(default_factory=dict)
    phases: dict[str, Array] = field(default_factory=dict)

    def make(self, spacecraft: "Spacecraft", default: Configuration) -> MultiSine:
        """Return the motion of this spacecraft's joints; see `HalfCosineMotion.make`."""
        if 0 < self.ramp < SHORTEST_RAMP:
            raise InputError(f"joint_motion.ramp must be at least {SHORTEST_RAMP:g} s")
        motion = MultiSine(
            centre=spacecraft.configuration({**default, **self.centre}, "joint_motion.centre"),
            amplitudes=self._table(spacecraft, "amplitudes"),
            frequencies=self.frequencies,
            phases=self._table(spacecraft, "phases"),
            ramp=self.ramp,
            duration=self.duration,
        )
        for extreme in motion.position_range():
            angles = dict(zip(spacecraft.joint_names, extreme, strict=True))
            spacecraft.configuration(angles, "joint_motion")
        _check_rates(motion, spacecraft, "give smaller amplitudes or frequencies")
        return motion

    def _table(self, spacecraft: "Spacecraft", key: str) -> NDArray[np.float64]:
        """Return amplitudes or phases as (K, J)."""
        names, count = spacecraft.joint_names, np.size(self.frequencies)
        table = np.zeros((count, len(names)))
        for name, values in getattr(self, key).items():
            if name not in names:
                raise InputError(
                    f"joint_motion.{key}: no joint '{name}'; {choose_from(name, names)}"
                )
            if np.shape(values) != (count,) or not np.isfinite(values).all():
                raise InputError(
                    f"joint_motion.{key}: {name} needs finite numbers, one for each of the "
                    f"{count} frequencies"
                )
            table[:, names.index(name)] = values
        return table


def _check_rates(motion: HalfCosine | MultiSine, spacecraft: "Spacecraft", remedy: str) -> None:
    rates, limits = motion.peak_rates(), spacecraft.velocity_limits
    if (rates > limits).any():
        k = int((rates > limits).argmax())
        raise InputError(
            f"joint_motion: {spacecraft.joint_names[k]} would reach {rates[k]:.3g}, above its "
            f"limit {limits[k]:.3g} rad/s; {remedy}"
        )
