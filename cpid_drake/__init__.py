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
- `validate`: predicts a log that was not used to identify a target;
- `TotalMomentum`: zero, unknown or known;
- `SensorSuite`, `load_sensors`, `Log`: sensors and their samples, each at its own rate;
- `read_log`, `write_log`, `from_columns`: logs as files, or from columns in memory;
- `ColumnMap`: names, units and conventions of a log's columns;
- `MomentumIdentifier`, `SpacecraftSensors`, `SensorIdentifier`, `JointController`,
  `JointTrajectory`, `SceneVisualizer`: Drake systems;
- `add_lcm`: an identifier whose inputs and outputs are LCM messages;
- `HalfCosine`, `MultiSine`, `Spline`: joint motions;
- `Scenario`, `load_scenario`, `shipped_scenario`, `find_scenario`, `make_simulation`: from YAML to
  a Diagram; `models_directory` has the models, scenarios and logs that come with the package;
- `export_target`: the target as URDF, SDF, MJCF or directives, alone or on the spacecraft;
- `InputError`: the exception for bad input.

The folders `dynamics`, `logs`, `simulation`, `planning`, `report` and others have public names of
their own, for studies such as those in `diagrams`.
"""

import lazy_loader

# The names are those of __init__.pyi; each is imported when it is first used, since Drake and SciPy
# take a second to load.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
