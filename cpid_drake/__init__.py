"""Identify a captured target's ten inertial parameters online, from momentum conservation.

The public names, from the ground up:

- `InertialParameters`: mass, centre of mass and inertia in every representation;
- `Spacecraft`: a model file as a known spacecraft with a base and a capture frame;
- `Telemetry`: samples of base and joint motion;
- `identify`: batch identification, giving an `Identification`;
- `SensorSuite`, `load_sensors`, `Measurements`: sensors and what they gave, each at its own rate;
- `identify_from_sensors`: batch identification from these;
- `read_telemetry`, `write_telemetry`: logs as files; `identify_log`: identification from a log;
- `MomentumIdentifier`, `SpacecraftSensors`, `SensorIdentifier`, `JointController`,
  `JointMotionSource`, `SceneVisualizer`: Drake systems;
- `HalfCosine`, `MultiSine`: joint motions;
- `Scenario`, `load_scenario`, `shipped_scenario`, `make_simulation`: from YAML to a Diagram;
- `export_target`: the target as URDF, SDF, MJCF or directives, alone or on the spacecraft;
- `InputError`: what bad input raises.
"""

from cpid_drake.dynamics.inertia import InertialParameters
from cpid_drake.dynamics.joint_motion import HalfCosine, JointMotion, MultiSine
from cpid_drake.dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from cpid_drake.dynamics.telemetry import Telemetry
from cpid_drake.errors import InputError
from cpid_drake.identification.identification import Identification, identify
from cpid_drake.identification.sensor_identification import identify_from_sensors
from cpid_drake.identification.telemetry_identification import LogIdentification, identify_log
from cpid_drake.scenario.files import load_scenario, shipped_scenario
from cpid_drake.scenario.schema import Scenario
from cpid_drake.scenario.simulation import Simulation, initial_state, make_simulation
from cpid_drake.sensing.files.telemetry_files import read_telemetry, write_telemetry
from cpid_drake.sensing.measurements import Measurements
from cpid_drake.sensing.presets import load_sensors
from cpid_drake.sensing.suite import SensorSuite
from cpid_drake.spacecraft.export.files import export_target
from cpid_drake.spacecraft.spacecraft import Spacecraft
from cpid_drake.systems.identifier import MomentumIdentifier
from cpid_drake.systems.joint_controller import JointController
from cpid_drake.systems.joint_motion_source import JointMotionSource
from cpid_drake.systems.scene_visualizer import SceneVisualizer
from cpid_drake.systems.sensor_identifier import SensorIdentifier
from cpid_drake.systems.spacecraft_sensors import SpacecraftSensors

__all__ = [
    "PARAMETER_NAMES",
    "PARAMETER_UNITS",
    "HalfCosine",
    "Identification",
    "InertialParameters",
    "InputError",
    "JointController",
    "JointMotion",
    "JointMotionSource",
    "LogIdentification",
    "Measurements",
    "MomentumIdentifier",
    "MultiSine",
    "Scenario",
    "SceneVisualizer",
    "SensorIdentifier",
    "SensorSuite",
    "Simulation",
    "Spacecraft",
    "SpacecraftSensors",
    "Telemetry",
    "export_target",
    "identify",
    "identify_from_sensors",
    "identify_log",
    "initial_state",
    "load_scenario",
    "load_sensors",
    "make_simulation",
    "read_telemetry",
    "shipped_scenario",
    "write_telemetry",
]
