"""A ROS 2 node that identifies: an identifier with subscriptions and publishers."""

import time
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from typing import Any, Protocol

import numpy as np

from cpid_drake.files.errors import InputError
from cpid_drake.identification.result import Identification
from cpid_drake.online.messages import OK, WARN, Messages, Status, statuses_of
from cpid_drake.online.ros_samples import LIVE_TYPES, RosSamples

TARGET, SIGMA, ESTIMATE = "~/target", "~/target_sigma", "~/estimate"
"""Topics of the estimate and of its σ, and of the ten parameters with their covariance."""

DIAGNOSTICS_TOPIC = "/diagnostics"
"""Topic of checks, error budget and topics, where ROS tools look for it."""

DEPTH = 2000
"""Messages of a topic that wait while a block is solved."""

PAUSE = 0.01
"""Time in which messages gather [s]: a callback costs much more than the messages that it takes."""

LOOK = 0.1
"""Time between two looks for the publishers of a topic [s]."""


class View(Protocol):
    """Shows a node while it runs."""

    def show(self, estimate: Identification, rows: Sequence[Status]) -> None:
        """Show the identification and the states of topics and stream that are published."""

    def draw(self) -> None:
        """Draw the latest samples; called again and again."""


class RosAdapter:
    """Connects an identifier with the topics of a node.

    It subscribes to each topic as soon as it has a publisher, with the reliability that this
    offers; the node's parameters of QoS overrides replace it. It publishes the target in the
    capture frame, stamped with the time until which samples are in it:

    - `~/target`, `~/target_sigma` (`geometry_msgs/InertiaStamped`): estimate and σ; NaN where not
      known. Its moments of inertia are about the centre of mass.
    - `~/estimate` (`std_msgs/Float64MultiArray`, 11 × 10): the parameters in the order of
      `PARAMETER_NAMES`, then their covariance;
    - `/diagnostics` (`diagnostic_msgs/DiagnosticArray`): what is known, checks, error budget,
      topics.

    Args:
        node: of `rclpy`; it is spun elsewhere.
        samples: takes the messages. What it says becomes a warning of the node.
        frame: name of the capture frame.
        period: time between published messages [s]; the node's parameter of this name replaces it.
        view: shows what is published; None for none.

    Raises:
        InputError: a period that is not positive.

    """

    def __init__(
        self,
        node: Any,
        samples: RosSamples,
        frame: str,
        *,
        period: float = 1.0,
        view: View | None = None,
    ) -> None:
        from rclpy.clock import Clock, ClockType

        self._view = view
        self._node, self._samples, self._frame = node, samples, frame
        samples.say = node.get_logger().warning
        period = float(node.declare_parameter("period", period).value)
        if not 0 < period < np.inf:
            raise InputError(f"period must be > 0 s, not {period}")
        self._messages, self._subscriptions = Messages(_class_of), dict[str, Any]()
        self._waiting, self._refused, self._published = dict(samples.topics), set[str](), 0
        kinds = {
            TARGET: "geometry_msgs/msg/InertiaStamped",
            SIGMA: "geometry_msgs/msg/InertiaStamped",
            ESTIMATE: "std_msgs/msg/Float64MultiArray",
            DIAGNOSTICS_TOPIC: "diagnostic_msgs/msg/DiagnosticArray",
        }
        self._publishers = {
            topic: node.create_publisher(_class_of(kind), topic, 10)
            for topic, kind in kinds.items()
        }
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # a simulated clock may stand still
        self._looking = node.create_timer(LOOK, self._look, clock=steady)
        node.create_timer(period, self.publish, clock=steady)

    def _look(self) -> None:
        """Subscribe to the topics that have a publisher now."""
        for kind, named in list(self._waiting.items()):
            topic = self._node.resolve_topic_name(named.partition(":")[0])
            offers = self._node.get_publishers_info_by_topic(topic)
            types = {offer.topic_type for offer in offers}
            usable = [each for each in LIVE_TYPES[kind] if each in types]
            if usable:
                self._subscribe(kind, topic, usable[0], offers)
                del self._waiting[kind]
            elif types and named not in self._refused:
                self._refused.add(named)
                self._samples.say(
                    f"{topic} has messages of {', '.join(sorted(types))}, not of "
                    f"{' or '.join(LIVE_TYPES[kind])}"
                )
        if not self._waiting:
            self._looking.cancel()

    def _subscribe(self, kind: str, topic: str, type_name: str, offers: Sequence[Any]) -> None:
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from rclpy.qos_overriding_options import QoSOverridingOptions

        best_effort = ReliabilityPolicy.BEST_EFFORT
        is_lossy = any(each.qos_profile.reliability == best_effort for each in offers)
        reliability = best_effort if is_lossy else ReliabilityPolicy.RELIABLE
        self._subscriptions[kind] = self._node.create_subscription(
            _class_of(type_name),
            topic,
            partial(self._take, kind),
            QoSProfile(depth=DEPTH, reliability=reliability),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )

    def _take(self, kind: str, message: Any) -> None:
        """Take a message, and all others that wait."""
        messages = [(kind, message)]
        for each, subscription in self._subscriptions.items():
            with subscription.handle:
                while taken := subscription.handle.take_message(subscription.msg_type, False):
                    messages.append((each, taken[0]))
        arrival = self._node.get_clock().now().nanoseconds
        self._samples.take_all(messages, arrival, time.monotonic())

    def publish(self) -> None:
        """Publish what is known, and the state of the topics."""
        samples, messages = self._samples, self._messages
        estimate, stamp = samples.identifier.estimate(), samples.stamp
        rows = [*samples.watch(time.monotonic()), self._stream(estimate)]
        if self._view is not None:
            self._view.show(estimate, rows)
        rows = [*statuses_of(estimate), *rows]
        array_of = messages.diagnostics(samples.newest, self._frame, rows)
        self._publishers[DIAGNOSTICS_TOPIC].publish(array_of)
        if stamp == self._published:
            return
        self._published = stamp
        sigma = np.sqrt(np.diag(estimate.covariance))
        for topic, values in ((TARGET, estimate.parameters), (SIGMA, sigma)):
            self._publishers[topic].publish(messages.inertia(stamp, self._frame, values))
        both = np.vstack([estimate.parameters, estimate.covariance])
        self._publishers[ESTIMATE].publish(messages.numbers(both, "row", "parameter"))

    def _stream(self, estimate: Identification) -> Status:
        """Return how the stream does."""
        behind = (self._samples.newest - self._samples.stamp) / 1e9 if self._samples.stamp else 0.0
        values = {f"rejected: {name}": count for name, count in estimate.rejected.items() if count}
        restarts = self._samples.restarts
        text = f"time jumped back {restarts} times" if restarts else ""
        values |= {"samples": estimate.sample_count, "restarts": restarts}
        return Status(
            WARN if restarts else OK,
            "stream",
            text,
            {**values, "estimate is behind the latest stamp [s]": f"{behind:.2f}"},
        )


def run(
    samples: RosSamples, frame: str, arguments: Sequence[str] = (), view: View | None = None
) -> Identification:
    """Run a node `cpid` until it is interrupted; return its identification.

    Args:
        samples: see `RosAdapter`.
        frame: name of the capture frame.
        arguments: of ROS, from "--ros-args" on.
        view: see `RosAdapter`.

    Raises:
        ImportError: there is no ROS 2, or packages of its messages are missing.
        InputError: the arguments are none of ROS; see also `RosAdapter`.

    """
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    try:
        rclpy.init(args=["cpid", *arguments])
    except Exception as error:  # of a class that depends on the version
        raise InputError(f"ROS: {error}") from error
    node, executor = rclpy.create_node("cpid"), SingleThreadedExecutor()
    try:
        RosAdapter(node, samples, frame, view=view)
        executor.add_node(node)
        while rclpy.ok():
            executor.spin_once(timeout_sec=1.0)
            if view is not None:
                view.draw()
            time.sleep(PAUSE)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return samples.identifier.finish()


def _class_of(name: str) -> Any:
    """Return the class of a message type."""
    package, _, kind = name.split("/")
    return getattr(import_module(f"{package}.msg"), kind)
