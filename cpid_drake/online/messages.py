"""ROS 2 messages of an identification, of the classes of `rosbags` or of those of ROS itself."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cpid_drake.identification.result import Identification

OK, WARN, ERROR, STALE = "OK", "WARN", "ERROR", "STALE"
"""Levels, as constants of `diagnostic_msgs/DiagnosticStatus` are called."""


@dataclass(frozen=True)
class Status:
    """A line of diagnostics.

    Attributes:
        level: OK, WARN, ERROR or STALE.
        name: of what is diagnosed; "cpid: " precedes it in messages.
        text: what is the matter.
        values: numbers and words by their names.

    """

    level: str
    name: str
    text: str = ""
    values: Mapping[str, object] = field(default_factory=dict)


class Messages:
    """Makes messages with stamps [ns] of classes that are found by their names.

    Args:
        find: returns the class of a name such as "std_msgs/msg/Header".

    """

    def __init__(self, find: Callable[[str], Any]) -> None:
        self._find = find

    def header(self, stamp: int, frame: str) -> Any:
        """Return a header."""
        seconds, rest = divmod(stamp, 10**9)
        own = self._find("builtin_interfaces/msg/Time")(sec=seconds, nanosec=rest)
        return self._find("std_msgs/msg/Header")(stamp=own, frame_id=frame)

    def inertia(self, stamp: int, frame: str, values: ArrayLike) -> Any:
        """Return ten parameters (10,) in a frame as `InertiaStamped`.

        The moments of inertia of both are about the centre of mass.
        """
        m, x, y, z, xx, yy, zz, xy, xz, yz = np.asarray(values, dtype=float).tolist()
        com = self._find("geometry_msgs/msg/Vector3")(x=x, y=y, z=z)
        own = self._find("geometry_msgs/msg/Inertia")(
            m=m, com=com, ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz
        )
        kind = self._find("geometry_msgs/msg/InertiaStamped")
        return kind(header=self.header(stamp, frame), inertia=own)

    def numbers(self, values: ArrayLike, *labels: str) -> Any:
        """Return an array as `Float64MultiArray`, row by row, with the names of its dimensions."""
        array = np.ascontiguousarray(values, dtype=np.float64)
        sizes = [int(np.prod(array.shape[k:])) for k in range(len(labels))]
        dimension = self._find("std_msgs/msg/MultiArrayDimension")
        dims = [
            dimension(label=label, size=size, stride=stride)
            for label, size, stride in zip(labels, array.shape, sizes)
        ]
        layout = self._find("std_msgs/msg/MultiArrayLayout")(dim=dims, data_offset=0)
        return self._find("std_msgs/msg/Float64MultiArray")(layout=layout, data=array.ravel())

    def diagnostics(self, stamp: int, frame: str, rows: Iterable[Status]) -> Any:
        """Return lines as `DiagnosticArray`."""
        status = self._find("diagnostic_msgs/msg/DiagnosticStatus")
        pair = self._find("diagnostic_msgs/msg/KeyValue")
        states = [
            status(
                level=getattr(status, row.level),
                name=f"cpid: {row.name}",
                message=row.text,
                hardware_id="cpid",
                values=[pair(key=key, value=str(value)) for key, value in row.values.items()],
            )
            for row in rows
        ]
        kind = self._find("diagnostic_msgs/msg/DiagnosticArray")
        return kind(header=self.header(stamp, frame), status=states)


def statuses_of(estimate: Identification) -> list[Status]:
    """Return what is known, every check, and the error budget, if there is one, as diagnostics."""
    level = OK if estimate.is_complete and estimate.passed else ERROR if estimate.failures else WARN
    rows = [Status(level, "estimate", estimate.explain(), {"rank": estimate.rank})]
    for check in estimate.checks:
        numbers = {"statistic": check.statistic, "limit": check.limit}
        shown = {key: f"{value:.4g}" for key, value in numbers.items() if value is not None}
        rows.append(Status(OK if check.passed else ERROR, check.name, check.sentence, shown))
    if estimate.budget:
        shares = {
            row.name: f"{np.nanmax(row.shares):.0%}"
            for row in estimate.budget
            if not np.isnan(row.shares).all()
        }
        text = "largest share of a parameter's variance that each error causes"
        rows.append(Status(OK, "error budget", text, shares))
    return rows
