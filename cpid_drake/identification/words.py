"""The words of warnings and failures: what a fit, and the samples of its logs, show a user."""

from collections.abc import Iterator, Sequence

import numpy as np

from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.files.digits import significant, with_half_width
from cpid_drake.identification.observed import Observed
from cpid_drake.logs.gyro_bias import GyroBias
from cpid_drake.sensors.sensors import SENSORS

LARGER_NOISE = 1.1
"""Factor of the noise from which a warning says so."""

SLOW = 0.1
"""Share of slow noise in the variance from which a warning says so."""


PLANAR_ASSUMED = (
    "the log has x, y and yaw only, so the spacecraft is taken to float on a table: only momentum "
    "in the plane is used (--planar says so, --no-planar is for a spacecraft that floats freely)"
)
"""The warning if a log without tilt and height is identified in the plane."""

PLANAR_PROPOSED = (
    "all joints rotate about one axis: if a table carries the spacecraft, say so with --planar, "
    "because its reactions are not in the equations otherwise"
)
"""The warning if such a spacecraft has no answer, or not a whole one."""

THRUST_NOT_USED = (
    "thrusters fired from {} s on, and {} does not use the log of thrust: identify with "
    "--estimator trajectory_fit"
)
"""The failed check of an estimator that assumes a constant momentum while thrusters fire."""

NOT_LINEAR = (
    "the inertia changed by {:.1g} % since the blocks are solved one after the other: they are not "
    "linear about the target; use the trajectory fit"
)
"""The failed check if the first blocks were linearized about another target."""

NO_FIT = "no fit of the {:.3g} s of samples so far explains them"
"""The failed check while no fit is found."""


def label_of(sensor: str) -> str:
    """Return the label of a sensor, or of a "sensor of log"."""
    name, of, log = sensor.partition(" ")
    label = SENSORS[name].quantity if name in SENSORS else name.replace("_", " ")
    return f"{label}{of}{log}"


def observed_warnings(observed: Observed) -> Iterator[str]:
    """Yield the warnings about gaps, noise and changes of the momentum."""
    for log, gaps in observed.gaps.items():
        yield from _of_gaps(gaps, f"{log}: " if len(observed.gaps) > 1 else "")
    larger = {name: factor for name, factor in observed.noise.items() if factor > LARGER_NOISE}
    if larger:
        parts = (f"the {label_of(name)} {significant(by)} times" for name, by in larger.items())
        text = "the residuals are larger than the declared noise"
        yield f"{text}: {', '.join(parts)} the given σ was assumed"
    slow = {name: each for name, each in observed.slow.items() if each[0] > SLOW}
    if slow:
        parts = (
            f"{100 * share:.0f} % of the {label_of(name)}'s over {significant(time)} s"
            for name, (share, time) in slow.items()
        )
        text = "noise is correlated in time, which the intervals contain"
        yield f"{text}: {', '.join(parts)}"
    if times := observed.changes:
        count = "once" if len(times) == 1 else f"{len(times)} times"
        text = f"the momentum changed {count}, last at {max(times):.3f} s"
        yield f"{text}; it was estimated again from then on"


def _of_gaps(gaps: Sequence[tuple[float, float]], where: str) -> Iterator[str]:
    """Yield the warning about a log's gaps; `where` comes before it."""
    if not gaps:
        return
    start, end = max(gaps, key=lambda gap: gap[1] - gap[0])
    text = "there is a gap" if len(gaps) == 1 else f"there are {len(gaps)} gaps, the longest"
    yield (
        f"{where}{text} from {start:.3f} s to {end:.3f} s in the samples of the joints: no sample "
        "inside is used, and attitude, position and momentum are estimated again behind it"
    )


def blocks_refused(count: int) -> str:
    """Return the warning about blocks that are left out."""
    blocks = "a block" if count == 1 else f"{count} blocks"
    return f"the samples of {blocks} are not used: no fit explains them"


def noise_not_stated(sensor: str) -> str:
    """Return the warning about a sensor without noise, and without a word that it is exact."""
    return (
        f"no noise of the {label_of(sensor)} is stated: it was taken as exact, to rounding; state "
        f"the noise of '{sensor}:', which `cpid log noise` shows"
    )


def bias_words(bias: GyroBias) -> str:
    """Return a gyro's bias with its 95 % intervals."""
    pairs = zip(np.degrees(bias.value), quantile_95() * np.degrees(bias.sigma), strict=True)
    shown = ", ".join(with_half_width(*pair) for pair in pairs if np.isfinite(pair[0]))
    return f"the gyro has a bias of ({shown}) deg/s against the attitude"


def bias_advice(bias: GyroBias) -> str:
    """Return what to state of a gyro's bias in a sensors' file."""
    return f"declare gyro.bias_deg_per_s: {significant(float(np.degrees(bias.size)))}"
