"""A log of a free-flyer that holds a target of 8.5 kg, as columns that tests change."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from sensing_cases import Sines

from cpid_drake import Scenario, load_scenario, shipped_scenario
from cpid_drake.dynamics.propagation import propagate
from cpid_drake.files.resources import models_directory
from cpid_drake.logs.formats import table_of
from cpid_drake.logs.log import Log, Samples
from cpid_drake.sensors.sensors import SENSORS

MODEL = models_directory() / "free_flyer/free_flyer.urdf"
FREE_FLYER = ("--model", MODEL, "--base", "body", "--capture-frame", "capture_point")
"""The spacecraft, as options of commands."""

SAMPLE = models_directory() / "telemetry/free_flyer.csv"
SENSORS_OF_SAMPLE = SAMPLE.with_name("free_flyer_sensors.yaml")
MOVING = np.array([0.02, -0.03, 0.04, 0.1, -0.2, 0.3])
"""A momentum [L; P] about W's origin of a drifting free-flyer [N·m·s, N·s]."""

MASS = 8.5
SIGMAS = {"attitude": 2e-4, "gyro": 3e-4, "position": 4e-4, "velocity": 1e-3}
SIGMAS |= {"encoders": 1e-4, "joint_rates": 1e-3}
JOINT, RATE = "q:arm_joint1", "qd:arm_joint1"


@cache
def flyer():
    return load_scenario(shipped_scenario("free_flyer_payload")).spacecraft.make()


def payload(duration: float, accuracy: float, **simulation) -> Scenario:
    """Return the scenario of the payload; further arguments are entries of its simulation."""
    scenario = load_scenario(shipped_scenario("free_flyer_payload"))
    scenario.simulation.duration = duration
    scenario.simulation.simulator.accuracy = accuracy
    for name, value in simulation.items():
        setattr(scenario.simulation, name, value)
    return scenario


@cache
def _columns(rate: float) -> dict[str, np.ndarray]:
    scenario, craft = load_scenario(shipped_scenario("free_flyer_payload")), flyer()
    drawn = Sines.drawn(4, 105, 10.0, 0.6)
    joints = replace(drawn, middle=np.array([2.7, -0.3, 1.1, -0.1]))
    time = np.arange(int(10 * rate) + 1) / rate
    base = propagate(craft.tree, joints, scenario.target_truth().to_standard_vector(), time)
    motion, rng = base.to_motion(craft.joint_names, time, joints), np.random.default_rng(7)
    samples = {}
    for name, sigma in SIGMAS.items():
        value = SENSORS[name].ideal(motion)
        value = value + sigma * rng.standard_normal(value.shape)
        if name == "attitude":
            value /= np.linalg.norm(value, axis=1, keepdims=True)
        samples[name] = Samples(time, np.round(value, 9))
    names, values = table_of(Log(craft.joint_names, samples))
    return dict(zip(names, values.T))


def columns(*groups: str, rate: float = 25.0) -> dict[str, np.ndarray]:
    """Return copies of the columns of some sensors, of 251 rows; joint 1 passes π."""
    kept = {"time"}
    for group in groups or ("attitude", "gyro", "position", "encoders"):
        kept |= {*SENSORS[group].columns_of(flyer().joint_names)}
    return {name: column.copy() for name, column in _columns(rate).items() if name in kept}


def rows_of(columns: dict[str, np.ndarray]) -> list[list[str]]:
    """Return header and rows as cells; NaN is an empty cell."""
    values = np.column_stack([*columns.values()]).tolist()
    return [[*columns], *([("" if x != x else repr(x)) for x in row] for row in values)]


def csv_of(columns: dict[str, np.ndarray], between: str = ",", end: str = "\n") -> str:
    return "".join(between.join(row) + end for row in rows_of(columns))


def write(folder: Path, content: str | bytes, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path
