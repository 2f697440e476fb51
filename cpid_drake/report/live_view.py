"""The live view of a scenario in the browser: its controls, and their actions."""

import time
from collections.abc import Callable

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from cpid_drake.identification.result import Identification
from cpid_drake.report.live_page import LivePage
from cpid_drake.report.replay import estimate_text
from cpid_drake.report.scene_legend import BODIES, all_layers, legend
from cpid_drake.scenario.simulation import Simulation, advance
from cpid_drake.systems.scene_layers import scale_length
from cpid_drake.systems.scene_visualizer import FRAME_PERIOD, SceneVisualizer

HIDDEN_AT_FIRST = ("frames W, B, C",)

START, PAUSE, STOP = "Start from the pose of the scenario", "Pause or continue", "Stop"
SPEED = "speed"

_POLL_PERIOD = 0.05  # [s] between two readings of the controls


class LiveView:
    """The controls of a live page, and the loop that reads them.

    Before a run, sliders pose the arms. The sliders do not affect the run, which starts from the
    scenario's pose. After the run, the page plays the recording under Meshcat's own controls.
    Numbers and legend lie over the scene, in a page of our own at `url`.

    Args:
        simulation: a simulation that was made with `meshcat`.
        meshcat: the scene.
        rate: initial ratio of simulated to real time.
        title: heading of the page.
        host: who may connect: "localhost" for this machine alone, "*" for all.

    Raises:
        InputError: no port is free for the page.

    """

    def __init__(
        self,
        simulation: Simulation,
        meshcat: Meshcat,
        rate: float = 1.0,
        *,
        title: str = "Live view",
        host: str = "localhost",
    ) -> None:
        self._simulation, self._meshcat = simulation, meshcat
        scene = simulation.diagram.GetSubsystemByName("scene_visualizer")
        if not isinstance(scene, SceneVisualizer):
            raise TypeError("the simulation was made without Meshcat")
        self._scene, size = scene, scene.extent.size
        self._layers = all_layers(size, with_truth=True)
        self._page = LivePage(meshcat.web_url(), title, scale_length(size), host)
        self._idle = "Press Start in Open Controls; until then, sliders pose the arms.", ""
        self._visible = {layer.name: layer.name not in HIDDEN_AT_FIRST for layer in self._layers}
        self._clicks: dict[str, int] = {}
        for name, key in ((START, "Enter"), (PAUSE, "Space"), (STOP, "Escape")):
            meshcat.AddButton(name, key)
        meshcat.AddSlider(SPEED, 0.1, 5.0, 0.1, rate)
        for layer in self._layers:
            meshcat.AddButton(f"show / hide {layer.name}")
        self._start = simulation.joint_motion.evaluate(0.0)[0]
        self._sliders: dict[int, str] = {}
        low, high = simulation.spacecraft.limits.lowest, simulation.spacecraft.limits.highest
        for k, joint in enumerate(simulation.spacecraft.joint_names):
            if not simulation.spacecraft.tree.is_rotor(k):
                self._sliders[k] = f"pose {joint}"
                limits = max(low[k], -np.pi), min(high[k], np.pi)
                meshcat.AddSlider(self._sliders[k], *limits, 0.01, self._start[k])

    @property
    def url(self) -> str:
        """Address of the page."""
        return self._page.url

    def serve(self, on_frame: Callable[[float, Identification], None]) -> None:
        """Run simulations, as commanded by the controls, until Stop is clicked.

        Call this in the thread that opened the page.

        Args:
            on_frame: called with the time [s] and the estimate at every frame of a run.

        Raises:
            InputError: the simulation fails.

        """
        while self._pose_until_start() and self._run(on_frame):
            pass
        self._show("Stopped.", "")

    def _show(self, heading: str, text: str) -> None:
        drawn = self._scene.drawn
        if self._meshcat.HasPath("/drake"):
            drawn |= {BODIES}
        visible = [layer for layer in self._layers if self._visible[layer.name]]
        self._page.show(heading, text, legend(visible, drawn))

    def _clicked(self, button: str) -> bool:
        """Return whether a button was clicked since the last call for the same button."""
        clicks = self._meshcat.GetButtonClicks(button)
        new = clicks > self._clicks.get(button, 0)
        self._clicks[button] = clicks
        return new

    def _toggle_layers(self) -> None:
        for layer in self._layers:
            if self._clicked(f"show / hide {layer.name}"):
                self._visible[layer.name] = not self._visible[layer.name]
                self._meshcat.SetProperty(f"/{layer.path}", "visible", self._visible[layer.name])

    def _pose_until_start(self) -> bool:
        """Draw the pose of the sliders until Start (True) or Stop (False) is clicked."""
        simulator = self._simulation.make_simulator()
        context = simulator.get_mutable_context()
        plant = self._simulation.plant
        plant_context = plant.GetMyMutableContextFromRoot(context)
        joints, _ = self._simulation.spacecraft.joint_state_columns
        columns = self._simulation.state_columns[joints]
        drawn = None
        while not self._clicked(STOP):
            if self._clicked(START):
                return True
            self._toggle_layers()
            q = self._start.copy()
            for k, name in self._sliders.items():
                q[k] = self._meshcat.GetSliderValue(name)
            if drawn is None or not np.array_equal(q, drawn):
                positions = plant.GetPositions(plant_context)
                positions[columns] = q
                plant.SetPositions(plant_context, positions)
                self._simulation.diagram.ForcedPublish(context)
                self._show(*self._idle)
            drawn = q
            time.sleep(_POLL_PERIOD)
        return False

    def _run(self, on_frame: Callable[[float, Identification], None]) -> bool:
        """Run and record the simulation once; return False if Stop was clicked."""
        meshcat, duration = self._meshcat, self._simulation.scenario.simulation.duration
        for k, name in self._sliders.items():
            meshcat.SetSliderValue(name, self._start[k])
        meshcat.DeleteRecording()
        meshcat.StartRecording(1 / FRAME_PERIOD)
        simulator = self._simulation.make_simulator()
        paused = stopped = False
        text = ""
        while simulator.get_context().get_time() < duration and not stopped:
            paused ^= self._clicked(PAUSE)
            stopped = self._clicked(STOP)
            self._toggle_layers()
            if paused:
                time.sleep(_POLL_PERIOD)
                simulator.ResetStatistics()  # do not make up for the time of the pause
                continue
            self._advance(simulator, duration)
            now = simulator.get_context()
            found = self._simulation.identification(now)
            text = estimate_text(found, self._simulation.truth)
            self._show(f"{now.get_time():.1f} of {duration:g} s", text)
            on_frame(now.get_time(), found)
        simulator.AdvancePendingEvents()
        meshcat.StopRecording()
        meshcat.PublishRecording()
        end = simulator.get_context().get_time()
        self._idle = f"The recording plays; these numbers are its last, of {end:g} s.", text
        return not stopped

    def _advance(self, simulator: Simulator, duration: float) -> None:
        rate = self._meshcat.GetSliderValue(SPEED)
        if simulator.get_target_realtime_rate() != rate:
            simulator.set_target_realtime_rate(rate)
            simulator.ResetStatistics()
        now = simulator.get_context().get_time()
        advance(simulator, min(duration, now + FRAME_PERIOD))
