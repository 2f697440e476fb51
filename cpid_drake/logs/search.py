"""The search for the readings of a log that agree best with each other and with the spacecraft.

A reading is an alternative to the map of columns that a log is read with. All readings have one
score, the comparisons of `logs.score`: the right one leaves noise, all others leave much more. The
guess of a map asks which reading of open keys is best, and a check of a log asks whether another
reading is clearly better than the given one.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from time import process_time

import numpy as np

from cpid_drake.dynamics.tree import KinematicTree
from cpid_drake.logs.alternatives import Alternative
from cpid_drake.logs.instants import Instants
from cpid_drake.logs.score import MOMENTUM, WORSE, Comparison, compare_momentum, compare_rates

EXPLAINS = 0.05
"""Largest residual of the momentum that a right convention leaves; smoothing leaves less."""

AGREES = 0.2
"""Largest residual of rates that agree with positions; another unit, axis or sign leaves 0.5."""

CLEARLY = 3.0
"""Ratio of residuals from which one convention explains a log clearly better than another."""

MOST = 3
"""Most readings that explain a log equally well and are named: more are no help."""


def limit_of(name: str) -> float:
    """Return the largest residual of a comparison that a right convention leaves."""
    return EXPLAINS if name == MOMENTUM else AGREES


class Budget:
    """The processor time of a search; once it is spent, nothing more is compared.

    Attributes:
        is_enough: whether all were compared so far.

    """

    def __init__(self, seconds: float) -> None:
        self._end, self.is_enough = process_time() + seconds, True

    def spent_on(self, readings: Iterable[Alternative]) -> Iterator[Alternative]:
        """Yield readings until the budget is spent."""
        for each in readings:
            if process_time() > self._end:
                self.is_enough = False
                return
            yield each


class Search:
    """Readings of a log, each with its residuals.

    Args:
        given: what the log says as read.
        names: the joints.
        tree: the spacecraft model; None to compare positions with rates only.
        kept: names of the comparisons that no reading may make worse; None for all.

    """

    def __init__(
        self,
        given: Instants,
        names: tuple[str, ...],
        tree: KinematicTree | None,
        kept: Collection[str] | None = None,
    ) -> None:
        self._names, self._has_momentum, self._kept = names, tree is not None, kept
        before = compare_rates(given, names) + compare_momentum(given, tree)
        self._now = {c.name: c.residual for c in before}
        self._rows = list[tuple[Alternative, Mapping[str, float]]]()

    def compare(self, readings: Iterable[Alternative]) -> None:
        """Add readings, except those in which quantities differ more than in the log as read."""
        for each in readings:
            then = _residuals(compare_rates(each.log, self._names))
            if self._contradicts(then):  # the momentum takes longer
                continue
            if self._has_momentum and not self._leaves_apart(then):
                then |= _residuals(compare_momentum(each.log, each.tree))
                if self._contradicts(then):
                    continue
            self._rows.append((each, then))

    def residual(self, name: str) -> float:
        """Return the residual of a comparison of the log as read; 0 if it is not possible."""
        return self._now.get(name, 0.0)

    def ranked(self, name: str) -> list[tuple[float, Alternative]]:
        """Return the readings with their mean residual of some comparisons, the best first.

        Of readings that are about as good, the one that was compared first comes first.

        Args:
            name: beginning of the comparisons' names.

        """
        rows = list[tuple[float, Alternative]]()
        for each, then in self._rows:
            values = [value for key, value in then.items() if key.startswith(name)]
            if values:
                rows.append((float(np.mean(values)), each))
        least = min((value for value, _ in rows), default=0.0)
        return sorted(rows, key=lambda row: row[0] > WORSE * least + 1e-9)

    @property
    def better(self) -> list[Alternative]:
        """The readings that explain the log clearly better than it is read, the usual one first.

        All explain it equally well; the more conventions differ, the better one must explain it.
        """
        rows = [(total, each) for total, each, _ in self._clearly_better()]
        least = min((total for total, _ in rows), default=0.0)
        return [each for total, each in rows if total < least + np.log(CLEARLY)]

    @property
    def named(self) -> list[Alternative]:
        """The better readings; none if they are too many."""
        better = self.better
        return better if len(better) <= MOST else []

    @property
    def explains_all(self) -> bool:
        """Whether the best reading, or else the log as read, leaves nothing unexplained."""
        rows = self._clearly_better()
        then = min(rows, key=lambda row: row[0])[2] if rows else self._now
        return all(value <= limit_of(name) for name, value in then.items())

    def _clearly_better(self) -> Sequence[tuple[float, Alternative, Mapping[str, float]]]:
        """Return readings that are clearly better than the given one, with a total and residuals.

        They explain what they improve, and need not explain what they leave as it is.
        """
        rows = []
        for each, then in self._rows:
            clearly = CLEARLY**each.count
            better = [n for n, value in then.items() if clearly * value < self.residual(n)]
            if better and all(then[n] < limit_of(n) for n in better):
                total = float(sum(np.log(value) for value in then.values()))
                rows.append((total + each.count * np.log(CLEARLY), each, then))
        return rows

    def _leaves_apart(self, then: Mapping[str, float]) -> bool:
        """Return whether attitude and gyro turn differently as read, and then, too."""
        return min(self.residual("attitude"), then.get("attitude", 0.0)) > AGREES

    def _contradicts(self, then: Mapping[str, float]) -> bool:
        now = {n: v for n, v in self._now.items() if self._kept is None or n in self._kept}
        return any(v > WORSE * now.get(n, np.inf) and v > EXPLAINS for n, v in then.items())


def _residuals(comparisons: Iterable[Comparison]) -> dict[str, float]:
    return {each.name: each.residual for each in comparisons}
