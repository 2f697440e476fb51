"""The noise that samples without declared sensors show: differences of neighbours, and rounding."""

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.sensing.measurements import Measurements, Samples
from cpid_drake.sensing.noise_estimation import noise_level, sensor_noise

MOST_DECIMALS = 12
"""Numbers with more decimals are not treated as rounded."""

SMOOTH = 0.05
"""Largest noise of joint positions, as a share of their spread, in samples of one motion."""

_QUANTITIES = ("attitude", "gyro", "position", "velocity", "encoders", "joint_rates")
_STATES = ("quaternion_WB", "w_WB", "p_WB", "v_WB", "q", "qdot")


def sample_sigmas(samples: Measurements | Telemetry) -> NDArray[np.float64]:
    """Return σ (12 + 2J,) of the noise in one sample, in the order of `momentum_rows.changed`.

    Of states, which may belong to unconnected instants, rounding is the only noise that can be
    seen. σ is zero for a sensor without samples.
    """
    parts = []
    is_motion = isinstance(samples, Measurements) and _is_one_motion(samples.encoders)
    for name, state in zip(_QUANTITIES, _STATES, strict=True):
        own = samples[name] if isinstance(samples, Measurements) else None
        value = getattr(samples, state) if own is None else own.value
        sigma = rounding(value) / np.sqrt(12) if len(value) else 0.0
        if is_motion and own is not None and len(own):
            with suppress(InputError):  # too few samples
                sigma = max(sigma, sensor_noise(name, own))
        parts.append(np.full(value.shape[1] if state in ("q", "qdot") else 3, sigma))
    return np.concatenate(parts)


def rounding(values: NDArray[np.float64]) -> float:
    """Return the unit of the last decimal of rounded numbers; zero for numbers of all digits."""
    values = values[np.isfinite(values) & (values != 0)]
    for decimals in range(MOST_DECIMALS + 1):
        scaled = values * 10.0**decimals
        whole = np.round(scaled)
        if np.all(whole != 0) and np.all(np.abs(scaled - whole) < 1e-3):
            return float(10.0**-decimals) if len(values) else 0.0
    return 0.0


def _is_one_motion(encoders: Samples) -> bool:
    """Return whether joint positions change little from sample to sample."""
    try:
        return noise_level(encoders) < SMOOTH * float(np.std(encoders.value, axis=0).max())
    except InputError:  # too few samples
        return False
