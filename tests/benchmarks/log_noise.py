"""Ways to spoil the noise of a log: stuck, noisier and coloured sensors."""

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
from figure_faults import Spikes
from log_spoils import Spoil, attitude_of, changed, values_of
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.presets import load_sensors
from cpid_drake.sensing.suite import SensorSuite


def held(name: str, every: int) -> Spoil:
    """Return a spoil that repeats every k-th sample until the next one."""
    return values_of(name, lambda value: value[np.arange(len(value)) // every * every])


def frozen(name: str, start: float, entry: int | None = None) -> Spoil:
    """Return a spoil in which a sensor (or one entry of it) keeps its value from a time on [s]."""

    def change(s: Samples) -> Samples:
        first = int(np.searchsorted(s.time, start))
        value = s.value.copy()
        columns = slice(None) if entry is None else slice(entry, entry + 1)
        value[first:, columns] = value[first, columns]
        return Samples(s.time, value)

    return changed(name, change)


def noisier(factor: float, *names: str) -> Callable[[SensorSuite], SensorSuite]:
    """Return a change of a suite: the white noise of the named sensors (or all) is larger."""
    entries = ("sigma", "cross_boresight_arcsec", "boresight_arcsec", "angle_random_walk")

    def change(suite: SensorSuite) -> SensorSuite:
        larger = {}
        for name in names or suite.present():
            own = {field.name for field in fields(suite[name])} & set(entries)
            sizes = {key: factor * getattr(suite[name], key) for key in own}
            larger[name] = replace(suite[name], **sizes)
        return replace(suite, **larger)

    return change


def coloured(sensors: str, rho: float, *names: str) -> Spoil:
    """Return a spoil that adds noise with a correlation of neighbours, of the suite's size.

    The samples must be without noise in the named sensors.

    Args:
        sensors: name of the suite.
        rho: correlation of neighbours.
        names: the sensors.

    """
    suite = load_sensors(sensors)

    def apply(m: Measurements) -> Measurements:
        rng = np.random.default_rng(6)
        for name in names:
            n, width = len(m[name]), 3
            white = rng.standard_normal((n + 500, width)) * np.sqrt(1 - rho**2)
            noise = lfilter([1.0], [1.0, -rho], white, axis=0)[500:] * suite.sigmas(name)
            if name == "attitude":
                turn = Rotation.from_rotvec(noise @ suite[name].R_BS.T)
                m = attitude_of(lambda R_WB, turn=turn: R_WB * turn)(m)
            else:
                m = values_of(name, lambda value, noise=noise: value + noise)(m)
        return m

    return apply


def spiked(sensors: str, name: str) -> Spoil:
    """Return a spoil with spikes of one sensor in 1 % of its samples."""
    suite = load_sensors(sensors)
    return lambda m: Spikes(name).apply(m, suite, np.random.default_rng(7))
