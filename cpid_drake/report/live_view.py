"""The live view of a scenario in the browser: its controls, and their actions."""

import time
from collections.abc import Callable

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.systems.analysis import Simulator

from cpid_drake.identification.result import Identification
from cpid_drake.scenario.simulation import Simulation, advance
from cpid_drake.systems.scene_visualizer import FRAME_PERIOD

LAYERS = {
    "spacecraft and target": "/drake",
    "estimated centre of mass": "/cpid/estimated_centre",
    "estimated inertia": "/cpid/estimated_inertia",
    "true inertia": "/cpid/true_inertia",
    "centre of mass of the whole system": "/cpid/centre_of_mass",
    "momentum": "/cpid/momentum",
    "trail": "/cpid/trail",
    "frames W, B, C": "/cpid/frames",
}
"""Labels of the layers that can be hidden, and their Meshcat paths."""

HIDDEN_AT_FIRST = ("frames W, B, C",)

START, PAUSE, STOP = "Start from the pose of the scenario", "Pause or continue", "Stop"
SPEED = "speed"

_POLL_PERIOD = 0.05  # [s] between two readings of the controls


class LiveView:
    """The controls of a live page, and the loop that reads them.

    Before a run, sliders pose the arms. The sliders do not affect the run, which starts from the
    scenario's pose. After the run, the page plays the recording under Meshcat's own controls.

    Args:
        simulation: a simulation that was made with `meshcat`.
        meshcat: the page.
        rate: initial ratio of simulated to real time.

    """

    def __init__(self, simulation: Simulation, meshcat: Meshcat, rate: float = 1.0) -> None:
        self._simulation, self._meshcat = simulation, meshcat
        self._visible = {name: name not in HIDDEN_AT_FIRST for name in LAYERS}
        self._clicks: dict[str, int] = {}
        for name, key in ((START, "Enter"), (PAUSE, "Space"), (STOP, "Escape")):
            meshcat.AddButton(name, key)
        meshcat.AddSlider(SPEED, 0.1, 5.0, 0.1, rate)
        for name in LAYERS:
            meshcat.AddButton(f"show / hide {name}")
        self._start = simulation.joint_motion.evaluate(0.0)[0]
        self._sliders: dict[int, str] = {}
        low, high = simulation.spacecraft.position_limits
        for k, joint in enumerate(simulation.spacecraft.joint_names):
            if not simulation.spacecraft.tree.is_rotor(k):
                self._sliders[k] = f"pose {joint}"
                limits = max(low[k], -np.pi), min(high[k], np.pi)
                meshcat.AddSlider(self._sliders[k], *limits, 0.01, self._start[k])

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

    def _clicked(self, button: str) -> bool:
        """Return whether a button was clicked since the last call for the same button."""
        clicks = self._meshcat.GetButtonClicks(button)
        new = clicks > self._clicks.get(button, 0)
        self._clicks[button] = clicks
        return new

    def _toggle_layers(self) -> None:
        for name, path in LAYERS.items():
            if self._clicked(f"show / hide {name}"):
                self._visible[name] = not self._visible[name]
                self._meshcat.SetProperty(path, "visible", self._visible[name])

    def _pose_until_start(self) -> bool:
        """Draw the pose of the sliders until Start (True) or Stop (False) is clicked."""
        simulator = self._simulation.make_simulator()
        context = simulator.get_mutable_context()
        plant = self._simulation.plant
        plant_context = plant.GetMyMutableContextFromRoot(context)
        columns, _ = self._simulation.spacecraft.joint_state_columns
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
            on_frame(now.get_time(), self._simulation.identification(now))
        simulator.AdvancePendingEvents()
        meshcat.StopRecording()
        meshcat.PublishRecording()
        return not stopped

    def _advance(self, simulator: Simulator, duration: float) -> None:
        rate = self._meshcat.GetSliderValue(SPEED)
        if simulator.get_target_realtime_rate() != rate:
            simulator.set_target_realtime_rate(rate)
            simulator.ResetStatistics()
        now = simulator.get_context().get_time()
        advance(simulator, min(duration, now + FRAME_PERIOD))
