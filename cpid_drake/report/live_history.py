"""The points of curves that grow while samples arrive, in bounded memory."""

from collections.abc import Sequence
from dataclasses import dataclass, field

MOST_POINTS = 600
"""So many points are kept: as many as a curve has pixels."""

Place = tuple[int, int]
"""Place in a history: how often its points changed as a whole, and how many it had."""

START = (-1, 0)
"""Place before all points."""

_ROUNDING = 1e-6  # of the spacing of points, whose times are rounded


@dataclass
class LiveHistory:
    """Points over time, evenly thinned: never more than `most`, the newest always among them.

    Attributes:
        most: the largest number of points.

    """

    most: int = MOST_POINTS
    _times: list[float] = field(default_factory=list)
    _points: list[str] = field(default_factory=list)
    _spacing: float = 0.0
    _version: int = 0

    def add(self, time: float, point: str) -> None:
        """Add a point; one of an earlier time begins a new history.

        Args:
            time: of the point [s].
            point: its text.

        """
        if self._times and time < self._times[-1]:
            self._times, self._points, self._spacing = [], [], 0.0
            self._version += 1
        spacing = self._spacing * (1 - _ROUNDING)
        is_too_near = len(self._times) > 1 and time - self._times[-2] < spacing
        if is_too_near or self._times[-1:] == [time]:
            del self._times[-1], self._points[-1]
        self._times.append(time)
        self._points.append(point)
        if len(self._times) > self.most:
            self._thin()

    def _thin(self) -> None:
        """Leave out every second point but the last."""
        even = (self._times[-1] - self._times[0]) / (len(self._times) - 1)
        self._spacing = 2 * max(self._spacing, even)
        self._times = [*self._times[:-1:2], self._times[-1]]
        self._points = [*self._points[:-1:2], self._points[-1]]
        self._version += 1

    def since(self, place: Place) -> tuple[Place, int, Sequence[str]]:
        """Return what changed since a place in the history.

        Args:
            place: that of an earlier call, or `START`.

        Returns:
            The present place; how many of the points at the earlier place are still valid; and the
            points that follow these.

        """
        version, count = place
        valid = max(count - 1, 0) if version == self._version else 0
        return (self._version, len(self._points)), valid, self._points[valid:]
