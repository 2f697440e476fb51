"""The expected duration of a long job, from its first steps."""

import time
from collections.abc import Callable

_FIRST_SECONDS = 2.0  # of the job, from which its duration is estimated
_SHORT = 10.0  # [s]; shorter jobs are not announced


class Forecast:
    """Announces once how long a job takes.

    Args:
        job: subject and verb of the announcement, such as "200 trials take".
        total: size of the job, in any unit.
        say: called with the announcement.
        least: part of the job that must be done before its speed can be told.

    """

    def __init__(
        self, job: str, total: float, say: Callable[[str], object], least: float = 0.0
    ) -> None:
        self._job, self._total, self._say, self._least = job, total, say, least
        self._start: tuple[float, float] | None = None
        self._is_said = False

    def update(self, done: float) -> None:
        """Take note of the part of the job that is done."""
        now = time.perf_counter()
        if self._start is None:
            self._start = now, done
            return
        seconds, part = now - self._start[0], done - self._start[1]
        if self._is_said or seconds < _FIRST_SECONDS or part <= 0 or part < self._least:
            return
        self._is_said = True
        duration = seconds / part * self._total
        if duration > _SHORT:
            self._say(f"{self._job} about {duration_text(duration)}")


def duration_text(seconds: float) -> str:
    """Return a duration in words, rounded to one or two digits."""
    if seconds < 90:
        return f"{round(seconds, -1):.0f} s" if seconds > 15 else f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} minutes"
    return f"{seconds / 3600:.2g} hours"
