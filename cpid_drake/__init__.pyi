from .dynamics.inertia import InertialParameters
from .dynamics.joint_motion import HalfCosine, JointMotion, MultiSine, Spline
from .dynamics.motion import Motion
from .dynamics.parameterizations import PARAMETER_NAMES, PARAMETER_UNITS
from .dynamics.total_momentum import TotalMomentum
from .dynamics.uncertainty import BodyUncertainty
from .files.errors import InputError
from .files.resources import __version__, find_scenario, models_directory, shipped_scenario
from .identification.comparison import Comparison, compare
from .identification.identify import identify
from .identification.identify_files import identify_files
from .identification.parameter import ParameterEstimate
from .identification.prior import TargetPrior
from .identification.request import Request
from .identification.result import Identification
from .identification.result_files import read_result, write_result
from .identification.validation import validate
from .logs.column_map import ColumnMap
from .logs.formats import read_log, write_log
from .logs.in_memory import from_columns as from_columns
from .logs.log import Log
from .online.online_identifier import OnlineIdentifier
from .report.live_page import LivePage
from .report.pages.identification import write_report
from .sensors.presets import load_sensors
from .sensors.suite import SensorSuite
from .simulation.scenario import Scenario
from .simulation.scenario_files import load_scenario, load_spacecraft
from .simulation.simulation import Simulation, make_simulation
from .spacecraft.reference import SpacecraftReference
from .spacecraft.spacecraft import Spacecraft
from .spacecraft.spacecraft_file import SpacecraftFile
from .spacecraft.target_export import export_target
from .systems.joint_controller import JointController
from .systems.joint_trajectory import JointTrajectory
from .systems.lcm import add_lcm
from .systems.momentum_identifier import MomentumIdentifier
from .systems.scene_page import keep_scene as keep_scene
from .systems.scene_visualizer import SceneVisualizer
from .systems.sensor_identifier import SensorIdentifier
from .systems.spacecraft_sensors import SpacecraftSensors

__all__ = [
    "PARAMETER_NAMES",
    "PARAMETER_UNITS",
    "BodyUncertainty",
    "ColumnMap",
    "Comparison",
    "HalfCosine",
    "Identification",
    "InertialParameters",
    "InputError",
    "JointController",
    "JointMotion",
    "JointTrajectory",
    "LivePage",
    "Log",
    "MomentumIdentifier",
    "Motion",
    "MultiSine",
    "OnlineIdentifier",
    "ParameterEstimate",
    "Request",
    "Scenario",
    "SceneVisualizer",
    "SensorIdentifier",
    "SensorSuite",
    "Simulation",
    "Spacecraft",
    "SpacecraftFile",
    "SpacecraftReference",
    "SpacecraftSensors",
    "Spline",
    "TargetPrior",
    "TotalMomentum",
    "__version__",
    "add_lcm",
    "compare",
    "export_target",
    "find_scenario",
    "from_columns",
    "identify",
    "identify_files",
    "keep_scene",
    "load_scenario",
    "load_sensors",
    "load_spacecraft",
    "make_simulation",
    "models_directory",
    "read_log",
    "read_result",
    "shipped_scenario",
    "validate",
    "write_log",
    "write_report",
    "write_result",
]
