"""A campaign as a file: a scenario, what varies from trial to trial, and what is required.

An axis is a key of the scenario with a distribution, a list or a grid of its values. So the checks
of scenarios are those of campaigns.
"""

import json
import re
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from hashlib import sha256
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from cpid_drake.array import Array
from cpid_drake.dynamics.uncertainty import BodyUncertainty
from cpid_drake.files.checked_yaml import from_tree, load_yaml
from cpid_drake.files.constraints import Limits, Numbers, Vector
from cpid_drake.files.dumping import to_tree
from cpid_drake.files.errors import InputError, choose_from, prefix_errors
from cpid_drake.files.resources import find_scenario, resolve_model
from cpid_drake.identification.estimators import methods
from cpid_drake.sensors.presets import suite_from_folder
from cpid_drake.sensors.sensors import SENSORS
from cpid_drake.simulation.scenario import Scenario
from cpid_drake.simulation.scenario_files import check_files, files_of, resolve_files
from cpid_drake.spacecraft.reference import Name

VERSION = 1
"""Version of the files of a campaign's folder; another one is refused."""


@dataclass
class Axis:
    """The values of one key: `uniform`, `log_uniform`, `normal`, `one_of` or `grid`.

    `uniform` and `log_uniform` have the ends [low, high], `normal` has [mean, σ]; each is a number,
    or a list with one number for each entry of the key. A value of `one_of` is drawn with equal
    probability. All values of a `grid` are tried: there are `Campaign.trials` trials for each
    combination of the values of all grids.
    """

    uniform: Annotated[Array, Numbers()] | None = None
    log_uniform: Annotated[Array, Numbers()] | None = None
    normal: Annotated[Array, Numbers()] | None = None
    one_of: Annotated[list[Any], Limits(min_length=1)] | None = None
    grid: Annotated[list[Any], Limits(min_length=1)] | None = None

    def __post_init__(self) -> None:
        given = [each.name for each in fields(self) if getattr(self, each.name) is not None]
        if len(given) != 1:
            names = ", ".join(each.name for each in fields(self))
            raise InputError(f"give one of {names}, not {' and '.join(given) or 'none'}")
        if self.numbers is None:
            return
        if len(self.numbers) != 2:
            raise InputError(f"{given[0]} must be a list of two, not {len(self.numbers)}")
        low, high = self.numbers
        if self.normal is not None and (high < 0).any():
            raise InputError("the σ of normal, its second entry, must not be negative")
        if self.normal is None and (low > high).any():
            raise InputError(f"{given[0]} must be [low, high], with low <= high")
        if self.log_uniform is not None and (low <= 0).any():
            raise InputError("the ends of log_uniform must be > 0")

    @property
    def numbers(self) -> Array | None:
        """The two numbers, or lists of numbers, of a distribution; None for lists and grids."""
        given = (self.uniform, self.log_uniform, self.normal)
        return next((each for each in given if each is not None), None)

    @property
    def is_number(self) -> bool:
        """Whether all values are single numbers."""
        if self.numbers is not None:
            return self.numbers.ndim == 1
        values = self.one_of or self.grid or []
        return all(isinstance(each, int | float) and not isinstance(each, bool) for each in values)

    def values(self) -> list[Any]:
        """Return the values of a list or a grid, or the ends of a distribution."""
        if self.numbers is None:
            return self.one_of or self.grid or []
        if self.normal is not None:
            return [self.normal[0].tolist()]
        return [each.tolist() for each in self.numbers]

    def draw(self, rng: np.random.Generator) -> Any:
        """Return one value; of a grid, its first."""
        if self.numbers is None:
            values = self.values()
            return values[rng.integers(len(values))] if self.one_of else values[0]
        low, high = self.numbers
        if self.normal is not None:
            return (low + high * rng.standard_normal(low.shape)).tolist()
        if self.uniform is not None:
            return (low + (high - low) * rng.random(low.shape)).tolist()
        return (low * (high / low) ** rng.random(low.shape)).tolist()


@dataclass
class ModelErrors:
    """Errors of the model that have given values, besides those drawn from a σ.

    Attributes:
        mass: relative error of the masses and inertias of all bodies of the spacecraft.
        grasp_mm, grasp_mrad: of the place and of the attitude of C on its body, in C.
        joint_zero_mrad: of all encoders' zeros [mrad or mm].
        delay_ms: by which sensors' stamps are late, by the names of the sensors.

    """

    mass: Annotated[float, Limits(gt=-1, le=10)] = 0.0
    grasp_mm: Vector = field(default_factory=lambda: np.zeros(3))
    grasp_mrad: Vector = field(default_factory=lambda: np.zeros(3))
    joint_zero_mrad: float = 0.0
    delay_ms: dict[str, float] = field(default_factory=lambda: dict.fromkeys(SENSORS, 0.0))

    def __post_init__(self) -> None:
        for name in self.delay_ms:
            if name not in SENSORS:
                raise InputError(f"delay_ms: no sensor '{name}'; {choose_from(name, [*SENSORS])}")

    @property
    def is_zero(self) -> bool:
        """Whether the model has none of these errors."""
        grasp = self.grasp_mm.any() or self.grasp_mrad.any()
        return not (self.mass or grasp or self.joint_zero_mrad or any(self.delay_ms.values()))


@dataclass
class Declared:
    """What is declared to the estimators where it is not the truth; null for the truth.

    `sensors` is a suite, named as in `SensorsConfig`; "none" for no suite. `momentum` is "zero",
    "unknown", or "known" for the true value; null for "unknown" if the momentum is not zero.
    """

    sensors: str | None = None
    known_bodies: BodyUncertainty | None = None
    momentum: Literal["zero", "known", "unknown"] | None = None


@dataclass
class TrialScenario(Scenario):
    """The scenario of one trial.

    `tumble_C` is the angular velocity with which the target rotated about its own centre of mass
    before the capture, in C [rad/s]; its angular momentum is added to that of
    `SimulationConfig.momentum_W`.
    """

    tumble_C: Vector = field(default_factory=lambda: np.zeros(3))
    errors: ModelErrors = field(default_factory=ModelErrors)
    declared: Declared = field(default_factory=Declared)


@dataclass
class Requirement:
    """An error that a share of the trials must not exceed.

    `error` is relative for mass and inertia, as 0.01 or "1 %", and in metres for the centre of
    mass.
    """

    error: float | str
    probability: Annotated[float, Limits(gt=0, lt=1)]

    def __post_init__(self) -> None:
        match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*%\s*", str(self.error))
        try:
            limit = float(match[1]) / 100 if match else float(self.error)
        except ValueError:
            raise InputError(
                f"error must be a number or a percentage, not {self.error!r}"
            ) from None
        if not 0 < limit < np.inf:
            raise InputError(f"error must be > 0, not {self.error}")
        self.limit = limit


@dataclass
class Campaign:
    """Trials of one scenario, and what varies.

    Attributes:
        scenario: a scenario's file, relative to the folder of the campaign, or a shipped name.
        trials: number of trials for each combination of the values of the grids.
        seed: determines all random numbers, with the number of a trial.
        engine: "propagator" for trials from the conservation of momentum, "drake" for trials of the
            scenario's Diagram.
        repeated: share of the propagator's trials that Drake repeats, to compare.
        bounds: share of the trials whose Cramér-Rao bound is computed.
        estimators: of `cpid_drake.identification.estimators.methods`; all get the same samples.
        fixed: keys of `TrialScenario`, such as simulation.duration, and their values in all trials.
        axes: keys of `TrialScenario`, such as target.mass, and what varies.
        requirements: what is required of the mass, the centre of mass (`com`) and the inertia.

    """

    scenario: Name
    trials: Annotated[int, Limits(ge=1)] = 200
    seed: Annotated[int, Limits(ge=0)] = 1
    engine: Literal["propagator", "drake"] = "propagator"
    repeated: Annotated[float, Limits(ge=0, le=1)] = 0.01
    bounds: Annotated[float, Limits(ge=0, le=1)] = 1.0
    estimators: Annotated[list[str], Limits(min_length=1)] = field(
        default_factory=lambda: ["trajectory_fit"]
    )
    fixed: dict[str, Any] = field(default_factory=dict)
    axes: dict[str, Axis] = field(default_factory=dict)
    requirements: dict[Literal["mass", "com", "inertia"], Requirement] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.estimators:
            if name not in methods():
                raise InputError(f"estimators: no '{name}'; {choose_from(name, [*methods()])}")


class CampaignPlan:
    """A campaign with its scenario, as one text that determines every trial.

    Args:
        text: JSON of the campaign, its scenario and the hashes of the files that it names.

    """

    def __init__(self, text: str) -> None:
        self.text = text
        tree = json.loads(text)
        if tree["version"] != VERSION:
            raise InputError(f"a campaign of version {tree['version']}; this program has {VERSION}")
        self.campaign = from_tree(Campaign, tree["campaign"], "campaign", "a campaign")
        self._scenario, self._folder = tree["scenario"], Path(tree["folder"])
        grids = {name: a.grid for name, a in self.campaign.axes.items() if a.grid is not None}
        self.points = [dict(zip(grids, values)) for values in product(*grids.values())]

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the text without the place of the campaign's file."""
        tree = {**json.loads(self.text), "folder": ""}
        return sha256(json.dumps(tree).encode()).hexdigest()

    @property
    def total(self) -> int:
        """Number of all trials."""
        return self.campaign.trials * len(self.points)

    def random(self, number: int, *purpose: int) -> np.random.SeedSequence:
        """Return the random numbers of a trial; other ones for each purpose."""
        return np.random.SeedSequence(self.campaign.seed, spawn_key=(number, *purpose))

    def values(self, number: int) -> dict[str, Any]:
        """Return the values of the axes in a trial, by the keys of the axes."""
        rng = np.random.default_rng(self.random(number, 1))
        drawn = {name: axis.draw(rng) for name, axis in self.campaign.axes.items()}
        return drawn | self.points[number // self.campaign.trials]

    def trial(self, values: dict[str, Any]) -> TrialScenario:
        """Return the scenario of a trial with these values.

        Raises:
            InputError: there is no such key, or a value is not possible.

        """
        tree = json.loads(json.dumps(self._scenario))
        for key, value in {**self.campaign.fixed, **values}.items():
            _set(tree, key, value)
            if key.startswith("target.solid"):
                tree["target"]["I_TTcm_C"] = None
        trial = from_tree(TrialScenario, tree, "trial", "a trial")
        resolve_files(trial, self._folder)
        if trial.declared.sensors not in (None, "none"):
            trial.declared.sensors = suite_from_folder(self._folder, trial.declared.sensors)
        return trial

    def check(self) -> None:
        """Refuse a campaign with an axis that has no key, or a value that is not possible.

        Every value of a list or grid and the ends of distributions are tried, one axis at a time.

        Raises:
            InputError: see `trial`; or the engine cannot simulate it.

        """
        axes = self.campaign.axes.items()
        first = {name: axis.values()[0] for name, axis in axes}
        changes = [(f"axes: {key}", {key: value}) for key, axis in axes for value in axis.values()]
        for where, change in [("", {}), *changes]:
            with prefix_errors(where):
                trial = self.trial({**first, **change})
                check_files(trial)
                world = trial.simulation
                rigid = not (world.wrist or world.sprung_masses or world.joint_compliance_urad)
                exact = trial.body_uncertainty() is None and trial.errors.is_zero
                if self.campaign.engine == "propagator" and not rigid:
                    raise InputError(
                        "a wrist, a sprung mass or a flexible joint moves in Drake only: "
                        "engine: drake"
                    )
                if self.campaign.engine == "drake" and not exact:
                    raise InputError(
                        "known_bodies and errors need engine: propagator; Drake simulates the "
                        "model as it is"
                    )


@lru_cache(maxsize=4)
def plan_of(text: str) -> CampaignPlan:
    """Return the plan of a text; each worker reads it once."""
    return CampaignPlan(text)


def load_campaign(path: str | Path) -> CampaignPlan:
    """Read a campaign from a YAML file, with the scenario that it names.

    Raises:
        InputError: no such file, not YAML, unknown keys, or values that are not possible.

    """
    file = resolve_model(path)
    campaign = load_yaml(Campaign, file, str(path), "a campaign")
    with prefix_errors(str(path)):
        name = campaign.scenario
        beside = file.parent / name
        source = resolve_model(beside if beside.is_file() else find_scenario(name))
        scenario = load_yaml(TrialScenario, source, name, "a scenario")
        resolve_files(scenario, source.parent)
    named = sorted((p.name, sha256(p.read_bytes()).hexdigest()) for p in files_of(scenario))
    text = {
        "version": VERSION,
        "campaign": to_tree(campaign),
        "scenario": to_tree(scenario),
        "folder": str(file.parent),
        "files": named,
    }
    plan = CampaignPlan(json.dumps(text, indent=1, sort_keys=False))
    with prefix_errors(str(path)):
        plan.check()
    return plan


def _set(tree: Any, key: str, value: Any) -> None:
    """Set the value of a key of nested mappings and lists, such as `simulation.burns.0.time`."""
    *path, last = key.split(".")
    for depth, part in enumerate(path):
        tree = tree[_entry(tree, part, ".".join(path[: depth + 1]))]
    tree[_entry(tree, last, key)] = value


def _entry(tree: Any, part: str, key: str) -> Any:
    """Return the key of a mapping or the index of a list."""
    if isinstance(tree, list) and part.isdigit() and int(part) < len(tree):
        return int(part)
    if isinstance(tree, dict) and part in tree:
        return part
    if isinstance(tree, dict):
        raise InputError(f"no key '{key}'; {choose_from(part, list(tree))}")
    raise InputError(f"no key '{key}': {part!r} is within {json.dumps(tree)[:60]}")
