"""`cpid live`: identification of samples as they arrive."""

import time
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from cyclopts.validators import Number as Within

import cpid_drake as cpid
from cpid_drake.commands import options
from cpid_drake.commands.groups import group
from cpid_drake.files.errors import InputError
from cpid_drake.identification.arguments import Arguments
from cpid_drake.identification.checked_log import in_joint_order
from cpid_drake.identification.description import describe
from cpid_drake.identification.identify_files import open_log, opened_inputs
from cpid_drake.live.ros2 import run
from cpid_drake.live.ros_samples import RosSamples, sources_of
from cpid_drake.logs.log import THRUST
from cpid_drake.report.scene import LatestState, Scene
from cpid_drake.report.terminal import shown_live
from cpid_drake.systems.scene_visualizer import FRAME_PERIOD

live = group("live")

REFRESH = 0.25
"""Time between two updates of what is shown [s]."""

PAGE = " (legend and numbers are in Open Controls)"
"""Remark beside the address of the page: Meshcat begins with its controls closed."""


@live.command
def replay(
    log: options.LogFile,
    /,
    *,
    chosen: options.LogOptions = options.LogOptions(),
    rate: Annotated[options.Number, Parameter(validator=Within(gte=0.1, lte=1e4))] = 1.0,
    show: Annotated[bool, Parameter(negative="--no-show")] = True,
    quiet: options.Quiet = False,
) -> int:
    """Feed a log through the online identifier in real time, and show the estimates.

    The end is that of `cpid identify`, with its exit codes.

    Args:
        rate: Ratio of replayed to real time.
        show: Draw the spacecraft and the estimate in Meshcat.

    """
    request = chosen.request(log)
    if request.estimator not in (None, "recursive_fit") or request.rows is not None:
        raise InputError(
            "cpid live identifies with recursive_fit: leave out --estimator and --rows"
        )
    inputs = opened_inputs(request, lambda step: None)
    craft = inputs.spacecraft
    if request.planar:
        craft = craft.on_table()
    suite = _sensors(inputs)
    _, file = open_log(request, craft.joint_names)
    seen = in_joint_order(file.log, craft)
    if seen.errors:
        raise InputError(f"{log}: {seen.errors[0]}")
    options.print_warnings(seen.warnings)
    samples = seen.log
    identifier = _identifier(inputs, craft, suite, reads_thrust=samples.has_thrust)
    # As in `identify`, a sensor without stated errors is not used.
    used = {*suite.present(), THRUST}
    stream = [each for each in samples.messages() if each[0] in used]
    first, last, latest = stream[0][1], stream[-1][1], LatestState(craft)
    has_rates = all(len(samples[name]) for name in ("gyro", "velocity", "joint_rates"))
    scene = Scene(craft, options.open_meshcat(PAGE), has_rates=has_rates) if show else None
    begin, shown, drawn = time.monotonic(), -np.inf, -np.inf
    found = identifier.estimate()
    with shown_live(options.log_console(quiet)) as screen:
        for count, (name, stamp, value) in enumerate(stream, start=1):
            lag = time.monotonic() - begin - (stamp - first) / rate
            if lag < 0:
                time.sleep(-lag)
            identifier.add(name, stamp, value)
            latest.add(name, value)
            now = time.monotonic()
            if now - shown > REFRESH:
                found, shown = identifier.estimate(), now
                screen.update(
                    "\n".join([_state(found, stamp, count, max(lag, 0.0)), *describe(found)])
                )
            if scene and now - drawn > FRAME_PERIOD and latest.state is not None:
                drawn = now
                scene.draw(stamp - first, latest.state, found)
        found = identifier.finish()
        screen.update(_state(found, last, len(stream), 0.0))
    if scene and latest.state is not None:
        scene.draw(last - first, latest.state, found)
    return options.finish(found, quiet)


def _state(found: "cpid.Identification", time: float, count: int, lag: float) -> str:
    rejected = sum(found.rejected.values())
    return f"{time:.1f} s: {count} samples, {rejected} rejected; {lag:.1f} s late"


@live.command
def ros2(
    ros: list[str] | None = None,
    /,
    *,
    chosen: options.LiveOptions = options.LiveOptions(),
    thrust_map: options.File | None = None,
    quiet: options.Quiet = False,
) -> int:
    """Run a ROS 2 node that identifies, until it is interrupted.

    It publishes ~/target, ~/target_sigma, ~/estimate and /diagnostics. The end is that of
    `cpid identify`, with its exit codes.

    Args:
        ros: After --: arguments of ROS, from --ros-args on.
        thrust_map: Text file of 6 rows, torque and force about the base's origin, with one number
            for each entry of a Float64MultiArray of thrust. Default: its entries are these six.

    """
    request, topics = chosen.make_request("", chosen.sensors), chosen.topics()
    inputs = opened_inputs(request, lambda step: None)
    craft = inputs.spacecraft.on_table() if request.planar else inputs.spacecraft
    suite = _sensors(inputs)
    used = sources_of(topics, suite)
    absent: dict[str, Any] = {name: None for name in suite.present() if name not in used}
    options.print_warnings(f"no topic measures '{name}': it is not used" for name in absent)
    suite = replace(suite, **absent)
    matrix = None
    if thrust_map is not None:
        try:
            matrix = np.loadtxt(thrust_map, ndmin=2)
        except (OSError, ValueError) as error:
            raise InputError(f"{thrust_map}: not 6 rows of numbers: {error}") from error
    identifier = _identifier(inputs, craft, suite, reads_thrust=THRUST in used, has_budget=True)
    samples = RosSamples(identifier, topics, thrust_map=matrix)
    with options.extra("ros2"):
        found = run(samples, request.spacecraft.capture_frame, ros or ())
    return options.finish(found, quiet)


def _sensors(inputs: Arguments) -> "cpid.SensorSuite":
    """Return the sensors; refuse to go on without them."""
    if inputs.sensors is None:
        raise InputError("cpid live needs the sensors' errors: give --sensors")
    return inputs.sensors


def _identifier(
    inputs: Arguments, craft: "cpid.Spacecraft", suite: "cpid.SensorSuite", **others: bool
) -> "cpid.OnlineIdentifier":
    """Return an identifier with what is known."""
    return cpid.OnlineIdentifier(
        craft,
        suite,
        momentum=inputs.momentum,
        prior=inputs.prior,
        known_bodies=inputs.known_bodies,
        **others,
    )
