"""`cpid live`: identification of samples as they arrive."""

import time
from typing import Annotated

import numpy as np
from cyclopts import App, Parameter
from cyclopts.validators import Number as Within
from rich.live import Live

import cpid_drake as cpid
from cpid_drake.commands import options
from cpid_drake.files.errors import InputError
from cpid_drake.identification.checked_log import in_joint_order
from cpid_drake.identification.description import describe
from cpid_drake.identification.identify_files import open_log, opened_inputs
from cpid_drake.logs.log import THRUST
from cpid_drake.report.scene import LatestState, Scene
from cpid_drake.systems.scene_visualizer import FRAME_PERIOD

live = App("live")

REFRESH = 0.25
"""Time between two updates of what is shown [s]."""


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
    """Feed a log through the online identifier in real time, and show what it knows.

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
    if inputs.sensors is None:
        raise InputError("cpid live needs the sensors' errors: give --sensors")
    craft = inputs.spacecraft
    if request.planar:
        craft = craft.on_table()
    _, file = open_log(request, craft.joint_names)
    seen = in_joint_order(file.log, craft)
    if seen.errors:
        raise InputError(f"{log}: {seen.errors[0]}")
    options.print_warnings(seen.warnings)
    samples = seen.log
    identifier = cpid.OnlineIdentifier(
        craft,
        inputs.sensors,
        momentum=inputs.momentum,
        prior=inputs.prior,
        reads_thrust=samples.has_thrust,
        known_bodies=inputs.known_bodies,
    )
    # As in `identify`, a sensor without stated errors is not used.
    used = {*inputs.sensors.present(), THRUST}
    stream = [each for each in samples.messages() if each[0] in used]
    first, last, latest = stream[0][1], stream[-1][1], LatestState(craft)
    has_rates = all(len(samples[name]) for name in ("gyro", "velocity", "joint_rates"))
    scene = Scene(craft, options.open_meshcat(), has_rates=has_rates) if show else None
    begin, shown, drawn = time.monotonic(), -np.inf, -np.inf
    found = identifier.estimate()
    with Live(console=options.log_console(quiet), refresh_per_second=8) as screen:
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
