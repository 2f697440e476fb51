"""What the samples of all logs show about the assumptions of a fit, in numbers."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from cpid_drake.estimation.log_state import LogState
from cpid_drake.estimation.residuals import ResidualSums
from cpid_drake.estimation.unknowns import Model
from cpid_drake.estimation.whiteness import Whiteness


@dataclass(frozen=True, eq=False)
class Observed:
    """What the samples show, batch or online.

    What is of a sensor is by its name, of several logs by "sensor of log".

    Attributes:
        tests: whiteness of the residuals.
        counts: numbers of outliers, which are not used, and of all samples, by log and sensor.
        changes: times at which the momentum changed [s].
        noise: factors of the declared σ.
        slow: share of slow noise in the variance, and its correlation time [s].
        gaps: start and end of the gaps of each log [s].

    """

    tests: Mapping[str, Whiteness] = field(default_factory=dict)
    counts: Mapping[tuple[str, str], tuple[int, int]] = field(default_factory=dict)
    changes: tuple[float, ...] = ()
    noise: Mapping[str, float] = field(default_factory=dict)
    slow: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    gaps: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        model: Model,
        logs: Sequence[LogState],
        sums: Sequence[Mapping[str, ResidualSums]],
        changes: Sequence[float],
    ) -> "Observed":
        """Return what the samples show.

        Args:
            model: the unknowns.
            logs: all blocks, or online those of the window, whose noise and gaps are judged.
            sums: of each log, over all samples so far.
            changes: times [s].

        """
        tests, counts, gaps = dict[str, Whiteness](), {}, {}
        noise, slow = dict[str, float](), dict[str, tuple[float, float]]()
        for log, of_log in zip(logs, sums, strict=True):
            where = f" of {log.name}" if len(logs) > 1 else ""
            for name in model.of_log(log.name).suite.present():
                own = of_log.get(name, ResidualSums())
                counts[log.name, name] = own.rejected, own.rejected + own.used
                if own.lags.pairs[0]:
                    tests[name + where] = own.lags.whiteness
            noise |= {name + where: factor for name, factor in log.noise_factors.items()}
            for name, process in {**log.noise.processes, **log.smoothness.processes}.items():
                slow[name + where] = process.slow / max(process.total, 1.0), process.tau
            ends = [k for k, link in enumerate(log.links) if link.gap]
            gaps[log.name] = [(log.blocks[k].end, log.blocks[k + 1].start) for k in ends]
        return cls(tests, counts, tuple(sorted(changes)), noise, slow, gaps)

    @property
    def used(self) -> Counter[str]:
        """Number of samples that are no outliers, by log."""
        used = Counter[str]()
        for (log, _), (far, count) in self.counts.items():
            used[log] += count - far
        return used

    @property
    def rejected(self) -> dict[str, int]:
        """Number of outliers by sensor."""
        rejected = Counter[str]()
        for (_, sensor), (far, _) in self.counts.items():
            rejected[sensor] += far
        return {name: count for name, count in rejected.items() if count}

    @property
    def worst_share(self) -> float:
        """Largest share of outliers of a sensor."""
        return max((far / max(count, 1) for far, count in self.counts.values()), default=0.0)
