"""The live view of a scenario in the browser, with Meshcat's own controls."""

import time

from pydrake.geometry import Meshcat
from pydrake.systems.framework import Context, EventStatus

from cpid_drake.simulation.simulation import Simulation
from cpid_drake.systems.scene_visualizer import FRAME_PERIOD

STOP = "Stop"

_POLL_PERIOD = 0.05  # [s] between two looks at the page


def serve(simulation: Simulation, meshcat: Meshcat, rate: float) -> None:
    """Run a simulation as soon as a page is open; play its recording until Stop is clicked.

    Call this in the thread that opened Meshcat.

    Args:
        simulation: a simulation that was made with this Meshcat.
        meshcat: the scene.
        rate: ratio of simulated to real time.

    Raises:
        InputError: the simulation fails.

    """
    meshcat.AddButton(STOP)

    def show(root_context: Context) -> EventStatus:
        if meshcat.GetButtonClicks(STOP):
            return EventStatus.ReachedTermination(simulation.diagram, "stopped")
        return EventStatus.DidNothing()

    while not meshcat.GetNumActiveConnections():
        time.sleep(_POLL_PERIOD)
    meshcat.StartRecording(1 / FRAME_PERIOD)
    simulation.run(show, realtime_rate=rate)
    meshcat.StopRecording()
    meshcat.PublishRecording()
    while not meshcat.GetButtonClicks(STOP):
        time.sleep(_POLL_PERIOD)
