"""The joint motions that a scenario can ask for."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.joint_motion import HalfCosine, MultiSine
from cpid_drake.errors import InputError, choose_from
from cpid_drake.spacecraft.spacecraft import Spacecraft

SHORTEST_RAMP = 1e-3
"""Of a motion [s]; accelerations would be beyond all numbers."""


@dataclass
class HalfCosineMotion:
    """Half-cosine motion between two configurations [rad or m by joint name], T = duration [s].

    Joints that a configuration does not name stand as `spacecraft.configuration` says.
    """

    duration: float = 10.0
    initial: dict[str, float] = field(default_factory=dict)
    final: dict[str, float] = field(default_factory=dict)

    def make(self, spacecraft: Spacecraft, standing: Mapping[str, float]) -> HalfCosine:
        """Return the motion of this spacecraft's joints; errors as `Scenario.make_joint_motion`.

        Args:
            spacecraft: whose joints move.
            standing: where joints are that the motion does not name [rad or m by joint name].

        """
        motion = HalfCosine(
            joint_configuration(spacecraft, standing, self.initial, "joint_motion.initial"),
            joint_configuration(spacecraft, standing, self.final, "joint_motion.final"),
            self.duration,
        )
        _check_rates(motion, spacecraft, "give a longer duration")
        return motion


@dataclass
class MultiSineMotion:
    """Sums of sines about a configuration, tagged `!MultiSineMotion` in YAML.

    `centre` [rad or m], `amplitudes` [rad or m] and `phases` [rad] are by joint name; the latter
    two are lists, one entry for each of the frequencies [Hz]. Where a joint is not named, its
    centre is as `spacecraft.configuration` says, the others are zero. The motion rises over the
    first `ramp` [s] and falls over the last.
    """

    duration: float = 10.0
    ramp: float = 2.0
    frequencies: np.ndarray = field(default_factory=lambda: np.zeros(0))
    centre: dict[str, float] = field(default_factory=dict)
    amplitudes: dict[str, np.ndarray] = field(default_factory=dict)
    phases: dict[str, np.ndarray] = field(default_factory=dict)

    def make(self, spacecraft: Spacecraft, standing: Mapping[str, float]) -> MultiSine:
        """Return the motion of this spacecraft's joints; as `HalfCosineMotion.make`."""
        if 0 < self.ramp < SHORTEST_RAMP:
            raise InputError(f"joint_motion.ramp must be at least {SHORTEST_RAMP:g} s")
        motion = MultiSine(
            centre=joint_configuration(spacecraft, standing, self.centre, "joint_motion.centre"),
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

    def _table(self, spacecraft: Spacecraft, key: str) -> np.ndarray:
        """Return amplitudes or phases as (K, J)."""
        names, count = spacecraft.joint_names, np.size(self.frequencies)
        table = np.zeros((count, len(names)))
        for name, values in getattr(self, key).items():
            _check_joint(spacecraft, name, f"joint_motion.{key}")
            if np.shape(values) != (count,) or not np.isfinite(values).all():
                raise InputError(
                    f"joint_motion.{key}: {name} needs finite numbers, one for each of the "
                    f"{count} frequencies"
                )
            table[:, names.index(name)] = values
        return table


JointMotionConfig = HalfCosineMotion | MultiSineMotion
"""The kinds of joint motion. In YAML the first is meant unless a tag, `!NAME`, says another."""


def joint_configuration(
    spacecraft: Spacecraft,
    standing: Mapping[str, float],
    angles: Mapping[str, float],
    where: str,
) -> NDArray[np.float64]:
    """Return q (J,) with the joints that `angles` names there, and the others as they stand.

    Raises:
        InputError: as `Spacecraft.configuration`; a position that is degrees is called that.

    """
    for name, value in angles.items():
        _check_joint(spacecraft, name, where)
        try:
            spacecraft.configuration({name: value}, where)
        except InputError as error:
            if abs(value) > 2 * np.pi and _is_possible(spacecraft, name, np.radians(value)):
                raise InputError(
                    f"{error}; angles are in radians: {value:g} degrees are {np.radians(value):.4g}"
                ) from error
            raise
    return spacecraft.configuration({**standing, **angles}, where)


def _is_possible(spacecraft: Spacecraft, joint: str, position: float) -> bool:
    try:
        spacecraft.configuration({joint: position}, "")
    except InputError:
        return False
    return True


def _check_joint(spacecraft: Spacecraft, name: str, where: str) -> None:
    if name not in spacecraft.joint_names:
        raise InputError(f"{where}: no joint '{name}'; {choose_from(name, spacecraft.joint_names)}")


def _check_rates(motion: HalfCosine | MultiSine, spacecraft: Spacecraft, remedy: str) -> None:
    rates, limits = motion.peak_rates(), spacecraft.velocity_limits
    if (rates > limits).any():
        k = int((rates > limits).argmax())
        raise InputError(
            f"joint_motion: {spacecraft.joint_names[k]} would reach {rates[k]:.3g}, above its "
            f"limit {limits[k]:.3g} rad/s; {remedy}"
        )
