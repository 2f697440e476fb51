"""An identification as ROS 2 messages in an MCAP file, for PlotJuggler, Foxglove and Rerun."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from cpid_drake.files.drafts import draft_of
from cpid_drake.files.errors import InputError
from cpid_drake.identification.identify_files import Evidence, converge
from cpid_drake.online.messages import ERROR, Messages, Status, statuses_of

TARGET, SIGMA = "/cpid/target", "/cpid/target_sigma"
"""Topics of the estimate and of its σ: `geometry_msgs/InertiaStamped`, in the capture frame."""

RESIDUALS = "/cpid/residuals/"
"""Topics of the residuals in σ, by sensor: `std_msgs/Float64MultiArray`."""

DIAGNOSTICS_TOPIC = "/cpid/diagnostics"
"""Topic of changes of the momentum, and of checks at the end: `diagnostic_msgs/DiagnosticArray`."""


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
    with draft_of(path) as draft:
        bag, connections = draft.with_name("bag"), dict[str, Any]()
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for stamp, topic, message in messages:
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=store)
                writer.write(connections[topic], stamp, store.serialize_cdr(message, kind))
        next(bag.glob("*.mcap")).replace(draft)


def _messages(types: Mapping[str, Any], evidence: Evidence) -> Iterator[tuple[int, str, Any]]:
    """Yield stamps [ns], topics and messages."""
    result, make = evidence.result, Messages(types.__getitem__)
    [source] = result.sources
    begin, frame = max(source.start, 0.0), source.request.spacecraft.capture_frame

    def stamp(time: float) -> int:
        return max(round((begin + max(time, 0.0)) * 1e9), 1)  # stamps of a bag are positive

    end = 0.0
    for time, estimate in converge(evidence):
        end, sigma = max(end, time), np.sqrt(np.diag(estimate.covariance))
        yield stamp(time), TARGET, make.inertia(stamp(time), frame, estimate.parameters)
        yield stamp(time), SIGMA, make.inertia(stamp(time), frame, sigma)
    for name, samples in result.residuals.items():
        for time, value in zip(samples.time.tolist(), samples.value, strict=True):
            yield stamp(time), RESIDUALS + name, make.numbers(value)
    for time in result.momentum_changes or ():
        row = Status(ERROR, "momentum", "the momentum changed")
        yield stamp(time), DIAGNOSTICS_TOPIC, make.diagnostics(stamp(time), frame, [row])
    yield stamp(end), DIAGNOSTICS_TOPIC, make.diagnostics(stamp(end), frame, statuses_of(result))
