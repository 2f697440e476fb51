"""`cpid live`: identification of samples as they arrive."""

from contextlib import ExitStack
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
from cpid_drake.identification.checked_log import in_joint_order, in_one_clock, with_clock_errors
from cpid_drake.identification.identify_files import open_log, opened_inputs
from cpid_drake.identification.log_sensors import exact_sensors
from cpid_drake.logs.joined import log_name
from cpid_drake.logs.log import THRUST
from cpid_drake.logs.screening import screen
from cpid_drake.logs.unlogged_joints import lock_unlogged
from cpid_drake.online.ros2 import run
from cpid_drake.online.ros_samples import RosSamples, sources_of
from cpid_drake.report.live_page import LivePage
from cpid_drake.report.live_server import LOCAL
from cpid_drake.report.live_view import NodeView, show_replay
from cpid_drake.report.replay import motion_of

live = group("live")


@live.command
def replay(
    log: options.LogFile,
    /,
    *,
    chosen: options.KnownOptions = options.KnownOptions(),
    part: options.PartOptions = options.PartOptions(),
    sensors: options.LiveSensors | None = None,
    rate: Annotated[options.Number, Parameter(validator=Within(gte=0.1, lte=1e4))] = 1.0,
    show: options.Show = True,
    host: options.Host = LOCAL,
    wait: options.Wait = False,
    quiet: options.Quiet = False,
) -> int:
    """Feed a log through the online identifier in real time, and show the estimates.

    The end is that of `cpid identify`, with its exit codes.

    Args:
        rate: Ratio of replayed to real time.

    """
    request = chosen.request_of(log, sensors, **part.reading())
    inputs, suite = _opened(request)
    _, file = open_log(request, inputs.spacecraft.joint_names)
    craft, fixed = lock_unlogged(inputs.spacecraft, file.log.joint_names)
    inputs = replace(inputs, spacecraft=craft)
    looked = in_joint_order(file.log, craft)
    if looked.errors:
        raise InputError(f"{log}: {looked.errors[0]}")
    screened = screen(looked.log, suite).log
    samples, shifted, others = in_one_clock(looked.log, screened, craft.tree)
    suite = with_clock_errors(suite, others) or suite
    options.print_warnings((*looked.warnings, *fixed, *shifted))
    identifier = _identifier(inputs, suite, reads_thrust=samples.has_thrust)
    # As in `identify`, a sensor without stated errors is not used.
    used = {*suite.present(), THRUST}
    stream = [each for each in samples.messages() if each[0] in used]
    drawn = None
    if show:
        try:
            motion = motion_of(samples, inputs.spacecraft, suite, np.inf)
            drawn = inputs.spacecraft, motion
        except InputError as error:
            options.print_warnings([f"nothing is drawn: {error}"])
    with ExitStack() as ends:
        page = ends.enter_context(LivePage(log_name(log), host=host)) if show else None
        answer = show_replay(identifier, stream, rate, options.log_console(quiet), page, drawn)
        code = options.finish(answer, quiet)
        if page is not None:
            page.close(wait=wait)
    return code


@live.command
def ros2(
    ros: list[str] | None = None,
    /,
    *,
    chosen: options.KnownOptions = options.KnownOptions(),
    sensors: options.LiveSensors | None = None,
    topic: options.Topics | None = None,
    thrust_map: options.File | None = None,
    show: options.Show = True,
    host: options.Host = LOCAL,
    wait: options.Wait = False,
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
    request = chosen.request_of("", sensors)
    topics = {"joints": "/joint_states"} | options.topics_of(topic)
    inputs, suite = _opened(request)
    used = sources_of(topics, suite)
    absent: dict[str, Any] = {name: None for name in suite.present() if name not in used}
    options.print_warnings(f"no topic measures '{name}': it is not used" for name in absent)
    matrix = None
    if thrust_map is not None:
        try:
            matrix = np.loadtxt(thrust_map, ndmin=2)
        except (OSError, ValueError) as error:
            raise InputError(f"{thrust_map}: not 6 rows of numbers: {error}") from error
    reads_thrust = THRUST in used
    identifier = _identifier(
        inputs, replace(suite, **absent), reads_thrust=reads_thrust, has_budget=True
    )
    samples = RosSamples(identifier, topics, thrust_map=matrix)
    frame = request.spacecraft.capture_frame
    with options.extra("ros2"), ExitStack() as ends:
        page = ends.enter_context(LivePage("cpid live ros2", host=host)) if show else None
        view = None if page is None else NodeView(samples, inputs.spacecraft, page)
        answer = run(samples, frame, ros or (), view)
        if view is not None:
            view.show(answer, ())
        code = options.finish(answer, quiet)
        if page is not None:
            page.close(wait=wait)
    return code


def _opened(request: "cpid.Request") -> tuple[Arguments, "cpid.SensorSuite"]:
    """Return the inputs of a request, and its sensors; refuse to go on without them."""
    inputs = opened_inputs(request, lambda step: None)
    if inputs.sensors is None:
        raise InputError("cpid live needs the sensors' errors: give --sensors")
    options.print_warnings(exact_sensors(inputs.sensors))
    craft = inputs.spacecraft.on_table() if request.planar else inputs.spacecraft
    return replace(inputs, spacecraft=craft), inputs.sensors


def _identifier(
    inputs: Arguments, suite: "cpid.SensorSuite", **others: bool
) -> "cpid.OnlineIdentifier":
    """Return an identifier with what is known."""
    return cpid.OnlineIdentifier(
        inputs.spacecraft,
        suite,
        momentum=inputs.momentum,
        prior=inputs.prior,
        known_bodies=inputs.known_bodies,
        **others,
    )
