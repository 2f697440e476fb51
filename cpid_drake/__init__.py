"""Identify a captured target's ten inertial parameters online, from momentum conservation.

The public names, in order of their dependencies:

- `InertialParameters`: mass, centre of mass and inertia in every representation;
- `Spacecraft`: a model file, with a base and a capture frame;
- `Motion`: samples of base and joint motion;
- `identify`: from `Motion` or `Log` to an `Identification`, by any estimator; it prints as a
  table, and each of its parameters is a `ParameterEstimate`;
- `identify_files`: the same from files, each with its `Request` and its `SpacecraftReference`;
- `load_spacecraft`: a spacecraft with its sensors from the file that `--spacecraft` reads;
- `write_report`, `read_result`, `write_result`: a result as a page, as JSON;
- `TargetPrior`: what is known about a target before its log;
- `BodyUncertainty`: how well the spacecraft's bodies, geometry and grasp are known;
- `compare`: whether results have the same target, a `Comparison`;
- `validate`: predicts a log that was not used to identify a target;
- `TotalMomentum`: zero, unknown or known;
- `SensorSuite`, `load_sensors`, `Log`: sensors and their samples, each at its own rate;
- `read_log`, `write_log`, `from_columns`: logs as files, or from columns in memory;
- `ColumnMap`: names, units and conventions of a log's columns;
- `MomentumIdentifier`, `SpacecraftSensors`, `SensorIdentifier`, `JointController`,
  `JointTrajectory`, `SceneVisualizer`: Drake systems;
- `LivePage`: a page that shows an identification while it runs, from a loop or a Diagram;
- `add_lcm`: an identifier whose inputs and outputs are LCM messages;
- `HalfCosine`, `MultiSine`, `Spline`: joint motions;
- `Scenario`, `load_scenario`, `shipped_scenario`, `find_scenario`, `make_simulation`: from YAML to
  a Diagram; `models_directory` has the models, scenarios and logs that come with the package;
- `export_target`: the target as URDF, SDF, MJCF or directives, alone or on the spacecraft;
- `InputError`: the exception for bad input.

Studies such as those in `diagrams` also use the modules of the folders `dynamics`, `logs`,
`simulation`, `planning` and others, by their names.
"""

from importlib import import_module

_MODULES = {
    "dynamics.inertia": ("InertialParameters",),
    "dynamics.joint_motion": ("HalfCosine", "JointMotion", "MultiSine", "Spline"),
    "dynamics.motion": ("Motion",),
    "dynamics.parameterizations": ("PARAMETER_NAMES", "PARAMETER_UNITS"),
    "dynamics.total_momentum": ("TotalMomentum",),
    "dynamics.uncertainty": ("BodyUncertainty",),
    "files.errors": ("InputError",),
    "files.resources": ("__version__", "find_scenario", "models_directory", "shipped_scenario"),
    "identification.comparison": ("Comparison", "compare"),
    "identification.identify": ("identify",),
    "identification.identify_files": ("identify_files",),
    "identification.parameter": ("ParameterEstimate",),
    "identification.prior": ("TargetPrior",),
    "identification.request": ("Request",),
    "identification.result": ("Identification",),
    "identification.result_files": ("read_result", "write_result"),
    "identification.validation": ("validate",),
    "online.online_identifier": ("OnlineIdentifier",),
    "logs.column_map": ("ColumnMap",),
    "logs.in_memory": ("from_columns",),
    "logs.formats": ("read_log", "write_log"),
    "logs.log": ("Log",),
    "report.live_page": ("LivePage",),
    "report.pages.identification": ("write_report",),
    "sensors.presets": ("load_sensors",),
    "sensors.suite": ("SensorSuite",),
    "simulation.scenario_files": ("load_scenario", "load_spacecraft"),
    "simulation.scenario": ("Scenario",),
    "simulation.simulation": ("Simulation", "make_simulation"),
    "systems.spacecraft_sensors": ("SpacecraftSensors",),
    "spacecraft.target_export": ("export_target",),
    "spacecraft.reference": ("SpacecraftReference",),
    "spacecraft.spacecraft": ("Spacecraft",),
    "spacecraft.spacecraft_file": ("SpacecraftFile",),
    "systems.joint_controller": ("JointController",),
    "systems.joint_trajectory": ("JointTrajectory",),
    "systems.lcm": ("add_lcm",),
    "systems.momentum_identifier": ("MomentumIdentifier",),
    "systems.scene_page": ("keep_scene",),
    "systems.scene_visualizer": ("SceneVisualizer",),
    "systems.sensor_identifier": ("SensorIdentifier",),
}
"""The public names by their modules; their types are in __init__.pyi. A module is imported when one
of its names is first used, since Drake and SciPy take a second to load."""

_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}

__all__ = sorted(_MODULE_OF)


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    return value


def __dir__() -> list[str]:
    return [*globals(), *__all__]
