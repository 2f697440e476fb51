"""The live view of a scenario in the browser: Meshcat's own controls, and their actions."""

import time
from collections.abc import Callable

from pydrake.geometry import Meshcat

from cpid_drake.identification.result import Identification
from cpid_drake.report.replay import estimate_text
from cpid_drake.report.scene_legend import legend
from cpid_drake.scenario.simulation import Simulation, advance
from cpid_drake.systems.scene_visualizer import FRAME_PERIOD, SceneVisualizer

START, PAUSE, STOP = "Start", "Pause or continue", "Stop"
SPEED = "speed"

_POLL_PERIOD = 0.05  # [s] between two readings of the controls
_PANEL_PERIOD = 0.5  # [s] between two updates of the numbers


class LiveView:
    """The controls of a live page, and the loop that reads them.

    Numbers and legend are in Meshcat's control panel; a click on a line of the legend hides or
    shows what it names. After a run, the page plays the recording under Meshcat's own controls.

    Args:
        simulation: a simulation that was made with `meshcat`.
        meshcat: the scene.
        rate: initial ratio of simulated to real time.

    """

    def __init__(self, simulation: Simulation, meshcat: Meshcat, rate: float = 1.0) -> None:
        self._simulation, self._meshcat = simulation, meshcat
        scene = simulation.diagram.GetSubsystemByName("scene_visualizer")
        if not isinstance(scene, SceneVisualizer):
            raise TypeError("the simulation was made without Meshcat")
        self._clicks: dict[str, int] = {}
        for name, key in ((START, "Enter"), (PAUSE, "Space"), (STOP, "Escape")):
            meshcat.AddButton(name, key)
        meshcat.AddSlider(SPEED, 0.1, 5.0, 0.1, rate)
        layers = legend(
            with_shapes=simulation.plant.geometry_source_is_registered(),
            with_boxes=scene.has_boxes,
            with_truth=True,
        )
        self._layers = {"; ".join(text for _, text in each.marks): each.path for each in layers}
        self._hidden = {"cpid/frames"}
        for name in self._layers:
            meshcat.AddButton(name)
        self._panel: list[str] = []

    def serve(self, on_frame: Callable[[float, Identification], None]) -> None:
        """Run simulations, as commanded by the controls, until Stop is clicked.

        Call this in the thread that opened the page.

        Args:
            on_frame: called with the time [s] and the estimate at every frame of a run.

        Raises:
            InputError: the simulation fails.

        """
        self._simulation.diagram.ForcedPublish(self._simulation.make_simulator().get_context())
        while self._is_started() and self._run(on_frame):
            pass

    def _is_started(self) -> bool:
        """Wait until Start (True) or Stop (False) is clicked."""
        while not self._clicked(STOP):
            if self._clicked(START):
                return True
            self._toggle_layers()
            time.sleep(_POLL_PERIOD)
        return False

    def _clicked(self, button: str) -> bool:
        """Return whether a button was clicked since the last call for the same button."""
        clicks = self._meshcat.GetButtonClicks(button)
        new = clicks > self._clicks.get(button, 0)
        self._clicks[button] = clicks
        return new

    def _toggle_layers(self) -> None:
        for name, path in self._layers.items():
            if self._clicked(name):
                self._hidden ^= {path}
                self._meshcat.SetProperty(f"/{path}", "visible", path not in self._hidden)

    def _show(self, text: str) -> None:
        """Replace the lines of text in the control panel."""
        for line in self._panel:
            self._meshcat.DeleteButton(line)
        self._panel = list(dict.fromkeys(line.strip() for line in text.splitlines()))
        for line in self._panel:
            self._meshcat.AddButton(line)

    def _run(self, on_frame: Callable[[float, Identification], None]) -> bool:
        """Run and record the simulation once; return False if Stop was clicked."""
        meshcat, duration = self._meshcat, self._simulation.scenario.simulation.duration
        meshcat.DeleteRecording()
        meshcat.StartRecording(1 / FRAME_PERIOD)
        simulator = self._simulation.make_simulator()
        paused = stopped = False
        last = -_PANEL_PERIOD
        while simulator.get_context().get_time() < duration and not stopped:
            paused ^= self._clicked(PAUSE)
            stopped = self._clicked(STOP)
            self._toggle_layers()
            rate = meshcat.GetSliderValue(SPEED)
            if paused or simulator.get_target_realtime_rate() != rate:
                simulator.set_target_realtime_rate(rate)
                simulator.ResetStatistics()  # do not make up for the time before
            if paused:
                time.sleep(_POLL_PERIOD)
                continue
            advance(simulator, min(duration, simulator.get_context().get_time() + FRAME_PERIOD))
            now = simulator.get_context()
            found = self._simulation.identification(now)
            if time.monotonic() > last + _PANEL_PERIOD or now.get_time() >= duration:
                last, text = time.monotonic(), estimate_text(found, self._simulation.truth)
                self._show(f"{now.get_time():.1f} of {duration:g} s\n{text}")
            on_frame(now.get_time(), found)
        simulator.AdvancePendingEvents()
        meshcat.StopRecording()
        meshcat.PublishRecording()
        return not stopped
