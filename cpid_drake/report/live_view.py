"""The live view of a scenario in the browser, with Meshcat's own controls."""

import time
from collections.abc import Callable

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, EventStatus

from cpid_drake.identification.result import Identification
from cpid_drake.report.replay import estimate_text
from cpid_drake.scenario.simulation import Simulation
from cpid_drake.systems.scene_visualizer import FRAME_PERIOD, LEGEND

RUN, STOP = "Run", "Stop"

_PANEL_PERIOD = 0.5  # [s] between two updates of the numbers, which take a message for each line
_POLL_PERIOD = 0.05  # [s] between two readings of the buttons


def serve(
    simulation: Simulation,
    meshcat: Meshcat,
    rate: float,
    on_estimate: Callable[[float, Identification], None],
) -> None:
    """Run a simulation whenever Run is clicked, until Stop is clicked.

    Numbers and legend are in Meshcat's control panel. After a run, the page plays the recording
    under Meshcat's own controls. Call this in the thread that opened Meshcat.

    Args:
        simulation: a simulation that was made with this Meshcat.
        meshcat: the scene.
        rate: ratio of simulated to real time.
        on_estimate: called with the time [s] and the estimate, twice a second.

    Raises:
        InputError: the simulation fails.

    """
    for name, key in ((RUN, "Enter"), (STOP, "Escape")):
        meshcat.AddButton(name, key)
    for color, text in LEGEND.items():
        meshcat.AddButton(f"{color}: {text}")
    simulation.diagram.ForcedPublish(simulation.make_simulator().get_context())
    panel: list[str] = []
    last = runs = 0.0

    def show(root_context: Context) -> EventStatus:
        nonlocal last, panel
        now, duration = root_context.get_time(), simulation.scenario.simulation.duration
        if time.monotonic() > last + _PANEL_PERIOD or now >= duration:
            last, found = time.monotonic(), simulation.identification(root_context)
            for line in panel:
                meshcat.DeleteButton(line)
            text = estimate_text(found, simulation.truth).splitlines()
            panel = list(dict.fromkeys([f"{now:.1f} of {duration:g} s", *map(str.strip, text)]))
            for line in panel:
                meshcat.AddButton(line)
            on_estimate(now, found)
        if meshcat.GetButtonClicks(STOP):
            return EventStatus.ReachedTermination(simulation.diagram, "stopped")
        return EventStatus.DidNothing()

    while not meshcat.GetButtonClicks(STOP):
        if meshcat.GetButtonClicks(RUN) > runs:
            meshcat.DeleteRecording()
            meshcat.StartRecording(1 / FRAME_PERIOD)
            simulation.run(show, realtime_rate=rate)
            meshcat.StopRecording()
            meshcat.PublishRecording()
            runs = meshcat.GetButtonClicks(RUN)
        time.sleep(_POLL_PERIOD)
