"""What is known besides the logs."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

from cpid_drake.dynamics.rows import RowFamily
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.errors import InputError
from cpid_drake.input_files.validation import from_tree, load_yaml
from cpid_drake.logs.noise_estimation import estimate_suite
from cpid_drake.resources import resolve_model
from cpid_drake.sensors.suite import SensorSuite

if TYPE_CHECKING:  # the registry of estimators is read without Drake
    from cpid_drake.identification.checked_log import CheckedLog
    from cpid_drake.identification.prior import TargetPrior
    from cpid_drake.spacecraft.spacecraft import Spacecraft


@dataclass(frozen=True, eq=False)
class Known:
    """What is known besides the logs, and holds for all of them.

    Attributes:
        spacecraft: the known spacecraft.
        sensors: the sensors' errors; None if they are unknown.
        momentum: the total momentum; None to test whether it is zero, and to estimate it if not.
        known_bodies: uncertainty of the spacecraft; None if it is exact.
        prior: what is known about the target; None for nothing.
        family: the row family, for an estimator that uses rows.

    """

    spacecraft: "Spacecraft"
    sensors: SensorSuite | None = None
    momentum: TotalMomentum | None = None
    known_bodies: BodyUncertainty | None = None
    prior: "TargetPrior | None" = None
    family: RowFamily | None = None


def suite_of(sensors: SensorSuite | None, log: "CheckedLog") -> tuple[SensorSuite, tuple[str, ...]]:
    """Return the sensors' errors, by default as the log shows them, and a warning if they are."""
    if sensors is not None:
        return sensors, ()
    text = "the sensors' noise was estimated from the log; give the sensors if you know them"
    return estimate_suite(log.measurements), (text,)


def read_uncertainty(text: str) -> BodyUncertainty:
    """Return an uncertainty from a YAML file, or from a text such as "mass=0.01,grasp_mm=2".

    Args:
        text: the path of a YAML file with the attributes of `BodyUncertainty` as keys, or pairs
            KEY=NUMBER with commas between them.

    Raises:
        InputError: no such file, not YAML, unknown keys, or values that are not numbers >= 0.

    """
    whole = "the uncertainty of known bodies"
    if "=" not in text:
        return load_yaml(BodyUncertainty, resolve_model(Path(text)), text, whole)
    tree: dict[str, object] = {}
    for pair in text.split(","):
        key, _, value = (part.strip() for part in pair.partition("="))
        if key in tree:
            raise InputError(f"{text}: the key '{key}' is given twice")
        try:
            tree[key] = float(value)
        except ValueError:
            names = ", ".join(entry.name for entry in fields(BodyUncertainty))
            raise InputError(
                f"{text}: '{pair.strip()}' is not KEY=NUMBER; the keys are {names}"
            ) from None
    return from_tree(BodyUncertainty, tree, text, whole)
