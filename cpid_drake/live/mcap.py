"""An identification as ROS 2 messages in an MCAP file, for PlotJuggler, Foxglove and Rerun."""

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cpid_drake.files.drafts import draft_of
from cpid_drake.files.errors import InputError
from cpid_drake.identification.identify_files import Evidence, converge

TARGET, SIGMA = "/cpid/target", "/cpid/target_sigma"
"""Topics of the estimate and of its σ: `geometry_msgs/InertiaStamped`, in the capture frame."""

RESIDUALS = "/cpid/residuals/"
"""Topics of the residuals in σ, by sensor: `std_msgs/Float64MultiArray`."""

DIAGNOSTICS = "/cpid/diagnostics"
"""Topic of changes of the momentum, and of checks at the end: `diagnostic_msgs/DiagnosticArray`."""

_NO_TIME = 1e-9  # stamps of a bag are positive


def write_mcap(path: str | Path, evidence: Evidence) -> None:
    """Write the estimates of one log over time, residuals and events as ROS 2 messages.

    Stamps are those of the log. Entries of the estimate that are not known are NaN.

    Args:
        path: the file; its name ends in .mcap.
        evidence: an identification from one file.

    Raises:
        InputError: several logs, another ending, `rosbags` is not installed, or the file cannot be
            written.

    """
    path = Path(path)
    if path.suffix != ".mcap":
        raise InputError(f"{path}: the name of an MCAP file must end in .mcap")
    if len(evidence.files) != 1:
        raise InputError(f"{path}: an MCAP file is written of one log, not of several")
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError("MCAP needs a package: pip install 'cpid-drake[ros]'") from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    messages = sorted(_messages(store.types, evidence), key=lambda each: each[0])
    with draft_of(path) as draft, tempfile.TemporaryDirectory(dir=path.parent) as folder:
        bag, connections = Path(folder, "bag"), dict[str, Any]()
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for stamp, topic, message in messages:
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                writer.write(connections[topic], stamp, store.serialize_cdr(message, kind))
        next(bag.glob("*.mcap")).replace(draft)


def _messages(types: Any, evidence: Evidence) -> Iterator[tuple[int, str, Any]]:
    """Yield stamps [ns], topics and messages."""
    result = evidence.found
    [source] = result.sources
    begin, frame = max(source.start, 0.0), source.request.spacecraft.capture_frame

    def stamp(time: float) -> int:
        return round((begin + max(time, _NO_TIME)) * 1e9)

    def header(time: float) -> Any:
        seconds, rest = divmod(stamp(time), 10**9)
        own = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
        return types["std_msgs/msg/Header"](stamp=own, frame_id=frame)

    def inertia(time: float, values: NDArray[np.float64]) -> Any:
        m, x, y, z, xx, yy, zz, xy, xz, yz = values.tolist()
        com = types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)
        own = types["geometry_msgs/msg/Inertia"](
            m=m, com=com, ixx=xx, ixy=xy, ixz=xz, iyy=yy, iyz=yz, izz=zz
        )
        return types["geometry_msgs/msg/InertiaStamped"](header=header(time), inertia=own)

    def diagnostics(time: float, rows: list[tuple[bool, str, str]]) -> Any:
        status = types["diagnostic_msgs/msg/DiagnosticStatus"]
        states = [
            status(
                level=status.OK if is_good else status.ERROR,
                name=f"cpid: {name}",
                message=text,
                hardware_id="cpid",
                values=[],
            )
            for is_good, name, text in rows
        ]
        return types["diagnostic_msgs/msg/DiagnosticArray"](header=header(time), status=states)

    end = 0.0
    for time, found in converge(evidence):
        end, sigma = max(end, time), np.sqrt(np.diag(found.covariance))
        yield stamp(time), TARGET, inertia(time, found.parameters)
        yield stamp(time), SIGMA, inertia(time, sigma)
    layout = types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    array = types["std_msgs/msg/Float64MultiArray"]
    for name, samples in result.residuals.items():
        for time, value in zip(samples.time.tolist(), samples.value, strict=True):
            data = np.ascontiguousarray(value, dtype=np.float64)
            yield stamp(time), RESIDUALS + name, array(layout=layout, data=data)
    for time in result.momentum_changes or ():
        row = (False, "momentum", "the momentum changed")
        yield stamp(time), DIAGNOSTICS, diagnostics(time, [row])
    rows = [(check.passed, check.name, check.sentence) for check in result.checks]
    yield stamp(end), DIAGNOSTICS, diagnostics(end, rows)
