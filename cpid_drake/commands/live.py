"""`cpid live`: identification of samples as they arrive."""

import time
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from cyclopts import App, Parameter
from cyclopts.validators import Number as Within
from rich.live import Live
from rich.table import Table

import cpid_drake as cpid
from cpid_drake.commands import options
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.estimation.least_squares import quantile_95
from cpid_drake.files.digits import with_half_width
from cpid_drake.files.errors import InputError
from cpid_drake.identification.checked_log import in_joint_order
from cpid_drake.identification.identify_files import open_log, opened_inputs
from cpid_drake.logs.log import THRUST
from cpid_drake.report.scene import LatestState, Scene
from cpid_drake.systems.scene_visualizer import FRAME_PERIOD

live = App("live")

REFRESH = 0.25
"""Time between two updates of the table [s]."""


@dataclass
class _Shown:
    """What the table shows.

    Attributes:
        found: the identification.
        time: stamp of the latest sample [s].
        count: number of samples so far.
        lag: time by which the replay is late [s].

    """

    found: "cpid.Identification"
    time: float
    count: int
    lag: float

    def table(self) -> Table:
        """Return the estimate, and how the stream does."""
        title = f"{self.time:.1f} s"
        table = Table("", "estimate", "± 95 %", "", title=title, caption=self._state())
        half = quantile_95() * np.sqrt(np.diag(self.found.covariance))
        for name, value, own, unit in zip(
            PARAMETER_NAMES, self.found.parameters, half, PARAMETER_UNITS, strict=True
        ):
            if np.isfinite(own):
                table.add_row(name, *with_half_width(value, own).split(" ± "), unit)
            else:
                table.add_row(name, "not known", "", unit)
        return table

    def _state(self) -> str:
        rejected, failed = sum(self.found.rejected.values()), self.found.failures
        text = f"{self.count} samples, {rejected} rejected; {self.lag:.1f} s late"
        return "; ".join([text, *(f"failed: {each}" for each in failed[:1])])


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
                screen.update(_Shown(found, stamp, count, max(lag, 0.0)).table())
            if scene and now - drawn > FRAME_PERIOD and latest.state is not None:
                drawn = now
                scene.draw(stamp - first, latest.state, found)
        found = identifier.finish()
        screen.update(_Shown(found, last, len(stream), 0.0).table())
    if scene and latest.state is not None:
        scene.draw(last - first, latest.state, found)
    return options.finish(found, quiet)
