"""ROS 2 messages as samples of an online identifier; without ROS, so that any loop can use it."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cpid_drake.estimation.block import SHORTEST_BLOCK
from cpid_drake.files.errors import InputError, listed
from cpid_drake.logs.log import THRUST
from cpid_drake.logs.ros_messages import (
    SOURCES,
    TOPIC_TYPES,
    joint_values,
    message_values,
    stamp_of,
    velocity_in_W,
)
from cpid_drake.logs.screening import LONGEST_DELAY
from cpid_drake.online.messages import OK, STALE, WARN, Status
from cpid_drake.online.online_identifier import OnlineIdentifier
from cpid_drake.sensors.suite import SensorSuite

LIVE_TYPES = TOPIC_TYPES | {"thrust": (*TOPIC_TYPES["thrust"], "std_msgs/msg/Float64MultiArray")}
"""Message types that are taken, by kind of topic."""

SILENT = 10
"""A topic is lost when so many sampling intervals of its slowest sensor are missing."""


def sources_of(kinds: Collection[str], suite: SensorSuite) -> dict[str, str]:
    """Return the kind of topic that each sensor's samples come from, and of thrust if there is one.

    The first kind of `SOURCES` that is there, as in bags. Joint positions and rates are those of
    "joints". Sensors that no topic measures are left out.

    Raises:
        InputError: a kind is none, there are no joints, or no topic of the base's motion.

    """
    for kind in kinds:
        if kind not in LIVE_TYPES:
            raise InputError(f"no topics of kind '{kind}'; choose from {', '.join(LIVE_TYPES)}")
    if "joints" not in kinds:
        raise InputError("no topic of joints: give one, as in joints=/joint_states")
    sources = {}
    for sensor in (*suite.present(), THRUST):
        usable = [each for each in SOURCES.get(sensor, ("joints",)) if each in kinds]
        if usable:
            sources[sensor] = usable[0]
    if not set(sources.values()) - {"joints", "thrust"}:
        raise InputError(
            "no topic of the base's motion that a sensor of the suite measures: give imu, odometry "
            "or pose, as in imu=/imu/data"
        )
    return sources


@dataclass
class _Topic:
    """What arrived on a topic.

    Attributes:
        name: of the topic.
        limit: time without messages after which it is lost [s].
        newest: latest stamp [ns].
        received: when the latest message arrived, or the first was expected, by the receiver's
            clock [s].
        count, unusable: number of messages.
        problem: why the latest unusable message since the last status was unusable.
        is_lost: whether it is lost.

    """

    name: str
    limit: float
    newest: int = 0
    received: float = np.nan
    count: int = 0
    unusable: int = 0
    problem: str = ""
    is_lost: bool = False


@dataclass(eq=False)
class RosSamples:
    """Gives messages of ROS 2 to an identifier, and watches their topics.

    Messages are read as those of bags; see `rosbag.read_rosbag`. Stamps are those of the headers; a
    message without a header has that of its arrival. A message of joints has all joints
    of the spacecraft; others in it are ignored. When the stamps of a topic jump back by more than
    `LONGEST_DELAY`, as at the start of a bag that is played again, the
    identifier begins again from the state that it had at first: the samples may be the
    same as before, and must not count twice.

    Args:
        identifier: the identifier.
        topics: names of the topics, by kind; of transforms with the frames of W and B,
            "/tf:world:base".
        thrust_map: (6, N) torque [N·m] and force [N] about the base's origin, in axes of B,
            for each entry of a `Float64MultiArray` of thrust; default: its six entries are these.
        say: called with a sentence when something happens: a topic is lost or returns, time
            jumps back, a message cannot be used.

    Raises:
        InputError: see `sources_of`; the map of the thrust has another shape.

    Attributes:
        restarts: how often the identifier began again.
        latest: the latest value by sensor.

    """

    identifier: OnlineIdentifier
    topics: Mapping[str, str]
    thrust_map: ArrayLike | None = None
    say: Callable[[str], object] = print
    restarts: int = field(default=0, init=False)
    latest: dict[str, ArrayLike] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self._stream, self._first = self.identifier.stream, self.identifier.state
        self._sources = sources_of(self.topics, self._stream.suite)
        self._map = np.eye(6) if self.thrust_map is None else np.array(self.thrust_map, dtype=float)
        if self._map.ndim != 2 or self._map.shape[0] != 6 or not np.isfinite(self._map).all():
            raise InputError(
                "thrust_map: give 6 rows, torque and force, of one number for each entry of the "
                f"messages, not an array of shape {self._map.shape}"
            )
        rates = {name: each.rate for name, each in self._stream.suite.present().items()}
        self._zero: int | None = None
        self._watched = dict[str, _Topic]()
        for kind, topic in self.topics.items():
            slowest = [rates[n] for n, of in self._sources.items() if of == kind and n in rates]
            limit = max(SHORTEST_BLOCK, SILENT / min(slowest)) if slowest else np.inf
            self._watched[kind] = _Topic(topic.partition(":")[0], limit)

    @property
    def stamp(self) -> int:
        """Stamp until which samples are in the estimate [ns]; zero before the first block."""
        until = self.identifier.known_until
        return 0 if np.isnan(until) or self._zero is None else self._zero + round(until * 1e9)

    @property
    def newest(self) -> int:
        """The latest stamp [ns]; zero before the first."""
        return max(topic.newest for topic in self._watched.values())

    def take(self, kind: str, message: Any, arrival: int, now: float) -> None:
        """Take a message.

        Args:
            kind: of its topic.
            message: any object with the fields of a type in `LIVE_TYPES`.
            arrival: stamp of its arrival, for a message without a header [ns].
            now: time of its arrival on a clock that never jumps [s].

        """
        topic = self._watched[kind]
        topic.count, topic.received = topic.count + 1, now
        if topic.is_lost:
            topic.is_lost = False
            self.say(f"{topic.name}: messages arrive")
        try:
            for part in self._parts(kind, message):
                stamp = stamp_of(part) if hasattr(part, "header") else arrival
                self._add(kind, topic, stamp, dict(self._samples(kind, part)))
        except InputError as error:
            topic.unusable += 1
            if not topic.problem:
                topic.problem = str(error)
                self.say(f"{topic.name}: {error}")

    def take_all(self, messages: Sequence[tuple[str, Any]], arrival: int, now: float) -> None:
        """Take messages that have waited, in the order of their stamps.

        In that of their topics, those of the last would be late, after all of the first.

        Args:
            messages: kinds of topics and messages.
            arrival, now: see `take`.

        """

        def stamp(pair: tuple[str, Any]) -> int:
            [first, *_] = getattr(pair[1], "transforms", None) or (pair[1],)
            return stamp_of(first) if hasattr(first, "header") else arrival

        for kind, message in sorted(messages, key=stamp):
            self.take(kind, message, arrival, now)

    def watch(self, now: float) -> list[Status]:
        """Return the state of each topic, and say which are lost.

        Args:
            now: see `take`.

        """
        return [self._status(topic, now) for topic in self._watched.values()]

    def _status(self, topic: _Topic, now: float) -> Status:
        values: dict[str, object] = {"messages": topic.count, "unusable": topic.unusable}
        if np.isnan(topic.received):
            topic.received = now
        silence, problem, topic.problem = now - topic.received, topic.problem, ""
        if silence > topic.limit:
            text = f"no message {'for' if topic.count else 'yet, after'} {silence:.1f} s"
            if not topic.is_lost:
                topic.is_lost = True
                self.say(f"{topic.name}: {text}")
            return Status(STALE, topic.name, text, values)
        if topic.newest:
            values["behind the latest stamp [s]"] = f"{(self.newest - topic.newest) / 1e9:.3f}"
        return Status(WARN if problem else OK, topic.name, problem, values)

    def _parts(self, kind: str, message: Any) -> Sequence[Any]:
        """Return the message, or its transforms between the named frames."""
        _, *frames = self.topics[kind].split(":")
        if not hasattr(message, "transforms"):
            return (message,)
        if len(frames) != 2:
            raise InputError(f"name the frames of world and base, as in {kind}=/tf:world:base")
        both = ((each.header.frame_id, each.child_frame_id) for each in message.transforms)
        chosen = (pair == tuple(frames) for pair in both)
        return [each for each, is_it in zip(message.transforms, chosen) if is_it]

    def _add(self, kind: str, topic: _Topic, stamp: int, samples: Mapping[str, ArrayLike]) -> None:
        """Give samples of one stamp to the identifier."""
        if stamp <= 0:
            raise InputError("the header has no stamp")
        if topic.newest - stamp > LONGEST_DELAY * 1e9:
            self._begin_again(topic, stamp)
        topic.newest = max(topic.newest, stamp)
        if self._zero is None:
            self._zero = stamp
        for name, value in samples.items():
            self.identifier.add(name, (stamp - self._zero) / 1e9, value)
            self.latest[name] = value

    def _begin_again(self, topic: _Topic, stamp: int) -> None:
        back = (topic.newest - stamp) / 1e9
        self.say(f"{topic.name}: time jumped back by {back:.1f} s; the identification begins again")
        self.identifier.state, self._zero = self._first, None
        self.restarts += 1
        for each in self._watched.values():
            each.newest = 0

    def _samples(self, kind: str, message: Any) -> Iterator[tuple[str, ArrayLike]]:
        """Yield the samples in a message of the sensors that have this source."""
        if kind == "joints":
            yield from self._joints(message)
            return
        if hasattr(message, "data"):
            data = np.asarray(message.data, dtype=float)
            if len(data) != self._map.shape[1]:
                raise InputError(
                    f"a message has {len(data)} entries, but thrust_map has {self._map.shape[1]} "
                    "columns"
                )
            values: dict[str, Any] = {THRUST: self._map @ data}
        else:
            values = dict(message_values(message, kind))
            if "velocity" in values:
                values["velocity"] = velocity_in_W(values["velocity"], values["attitude"])
        for name, value in values.items():
            if self._sources.get(name) == kind:
                yield name, value

    def _joints(self, message: Any) -> Iterator[tuple[str, ArrayLike]]:
        values = joint_values(message, "a message", self._watched["joints"].count - 1)
        joints = self._stream.joint_names
        missing = [name for name in joints if f"q:{name}" not in values]
        if missing:
            raise InputError(
                f"a message has no position of {listed(missing)}; one message must have all joints"
            )
        yield "encoders", [values[f"q:{name}"][0] for name in joints]
        rates = [values.get(f"qd:{name}", (np.nan,))[0] for name in joints]
        if "joint_rates" in self._sources and not np.isnan(rates).any():
            yield "joint_rates", rates
