"""The words of warnings: what a fit, and the samples of its logs, show a user."""

from collections.abc import Iterator, Sequence

from cpid_drake.files.digits import significant
from cpid_drake.identification.observed import Observed
from cpid_drake.sensors.sensors import SENSORS

SEEN = 1.1
"""Factor of the noise from which a warning says so."""

SLOW = 0.1
"""Share of slow noise in the variance from which a warning says so."""


def label_of(sensor: str) -> str:
    """Return the label of a sensor, or of a "sensor of log"."""
    name, of, log = sensor.partition(" ")
    label = SENSORS[name].quantity if name in SENSORS else name.replace("_", " ")
    return f"{label}{of}{log}"


def observed_warnings(observed: Observed) -> Iterator[str]:
    """Yield the warnings about gaps, noise and changes of the momentum."""
    for log, gaps in observed.gaps.items():
        yield from _of_gaps(gaps, f"{log}: " if len(observed.gaps) > 1 else "")
    larger = {name: factor for name, factor in observed.noise.items() if factor > SEEN}
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
