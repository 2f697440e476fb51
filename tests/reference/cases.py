"""The cases of the reference table: each returns a row, or rows by name."""

import json
import re
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from hardware_draws import KINDS
from logs import Repeated, World, log_of, save, write_columns
from pyarrow import parquet
from rows import (
    CAUGHT,
    EXACT,
    Trial,
    cli,
    cli_trial,
    identified,
    monte_carlo,
    python,
    row_of,
    suite_file,
    suite_of,
    trial_of,
)
from scipy.spatial.transform import Rotation, Slerp

from cpid_drake import (
    InertialParameters,
    SensorSuite,
    Spacecraft,
    TotalMomentum,
    identify,
    load_scenario,
    read_log,
    shipped_scenario,
)

Rows = dict[str, dict]
Columns = dict[str, np.ndarray]
SAMPLE = Path(__file__).parents[2] / "models" / "telemetry" / "free_flyer.csv"
UNKNOWN = {"momentum": TotalMomentum.unknown()}


def world_of(name: str, rng: np.random.Generator | None = None) -> World:
    return World(load_scenario(shipped_scenario(name)), rng)


def figure(value: float | None, **tolerance: float) -> dict:
    return {"value": value, **tolerance}


# -- the paper and exact data ---------------------------------------------------------------------


def paper(folder: Path) -> dict:
    """The paper's tables, by `diagrams/paper/run.py`."""
    script = Path(__file__).parents[2] / "diagrams/paper/run.py"
    python(script, "--out", folder / "paper", "--quiet")
    found = json.loads((folder / "paper" / "summary.json").read_text(encoding="utf-8"))
    one, seven = found["table1"], found["figure7"]
    figures = {
        "exact": figure(one["exact"]["max_relative_error"], at_most=1e-9),
        "rounded to 6 decimals": figure(one["rounded6"]["max_relative_error"], within=0.02),
        "attitude, Fig. 7": figure(seven["attitude"], within=0.02),
        "position, Fig. 7": figure(seven["position"], within=0.02),
    }
    figures |= {
        f"mass of {e['decimals']} decimals": figure(e["mass"], within=1e-5) for e in found["table2"]
    }
    why = "the same rounded numbers: masses to 1e-5, errors to 2 %; exact data: an absolute floor"
    return row_of("diagrams/paper/run.py: Tables 1, 2, Fig. 7", [], figures=figures, why=why)


def exact(folder: Path) -> Rows:
    """States without errors at 16 Hz, by three families of rows."""
    world, times, rows = world_of("exciting_motion"), np.arange(161) / 16, {}
    m, joints = world.run(times), world.craft.joint_names
    groups = {
        ("qw", "qx", "qy", "qz"): m["R"].as_quat(scalar_first=True),
        ("x", "y", "z"): m["p"],
        ("wx", "wy", "wz"): m["w"],
        ("vx", "vy", "vz"): m["v"],
        tuple(f"q:{name}" for name in joints): m["q"],
        tuple(f"qd:{name}" for name in joints): m["qdot"],
    }
    save(
        log := folder / "log.parquet",
        {n: (times, v) for names, value in groups.items() for n, v in zip(names, value.T)},
    )
    for family in ("standard", "relative", "eq18"):
        trial = cli_trial(world, folder, log, "--rows", family)
        figures = {"relative error": figure(trial.relative, at_most=1e-10)}
        what = f"exact states at 16 Hz, {family} rows"
        rows[f"exact_{family}"] = row_of(what, [trial], figures=figures, why=EXACT)
    return rows


def simulated(folder: Path) -> dict:
    """`cpid simulate` in Drake, then `cpid identify`."""
    cli("simulate", "free_flyer_payload", "--out", folder / "run", "--quiet")
    log = folder / "run" / "telemetry.csv"
    trial = cli_trial(world_of("free_flyer_payload"), folder, log)
    figures = {"relative error": figure(trial.relative, at_most=1e-7)}
    what = "cpid simulate free_flyer_payload (Drake, accuracy 3e-11), then cpid identify"
    return row_of(what, [trial], figures=figures, why=EXACT)


def free_flyer(folder: Path) -> dict:
    """The shipped sample, as the README identifies it."""
    trial = cli_trial(
        world_of("free_flyer_payload"),
        folder,
        SAMPLE,
        "--sensors",
        SAMPLE.with_name("free_flyer_sensors.yaml"),
    )
    return row_of("the README's log of a free-flyer", [trial])


# -- other worlds ---------------------------------------------------------------------------------


def at_rate(rate: float, *names: str) -> SensorSuite:
    suite = deepcopy(suite_of("flight"))
    for name in names:
        getattr(suite, name).rate = rate
    return suite


def tumbling(world: World) -> World:
    """Spacecraft and target tumble at 30°/s."""
    axis = np.array([0.6, -0.48, 0.64])
    world.momentum = world.spinning(np.radians(30.0) * axis, np.array([4e-3, 2e-3, -3e-3]))
    return world


def fired(world: World) -> World:
    """A thruster adds a momentum at 5 s."""
    world.kicks = ((5.0, np.array([6.0, -4.0, 5.0, 3.0, -2.0, 2.0])),)
    return world


class FastWheels:
    """The motion of an arm, with wheels at 3000 rpm whose speeds change by 10 rad/s."""

    def __init__(self, world: World) -> None:
        self._arm, names = world.motion, world.craft.joint_names
        self._wheel = np.array(["wheel" in name for name in names])
        swing = {"wheel1_spin": 10.0, "wheel3_spin": -5.0}
        self._swing = np.array([swing.get(name, 0.0) for name in names])

    def evaluate(self, time):
        t, w = np.asarray(time, dtype=float)[..., None], 0.1 * np.pi
        speed = 100 * np.pi * self._wheel
        q = speed * t + self._swing * (1 - np.cos(w * t)) / w
        rates = [speed + self._swing * np.sin(w * t), self._swing * w * np.cos(w * t)]
        return np.where(self._wheel, 0.0, self._arm.evaluate(time)) + np.stack([q, *rates], axis=-2)

    def breaks(self):
        return self._arm.breaks()


def with_fast_wheels(world: World) -> World:
    world.motion = FastWheels(world)
    world.momentum = world.spinning(np.zeros(3), np.zeros(3))
    return world


def in_the_plane(world: World) -> World:
    """Three parallel joints move in the plane of symmetry of spacecraft and target."""
    scenario = deepcopy(world.scenario)
    scenario.target = replace(load_scenario(shipped_scenario("paper")).target, visual_model=None)
    motion = scenario.joint_motion
    motion.centre = {"arm_joint2": -0.8, "arm_joint4": 1.3, "arm_joint6": 0.6}
    motion.frequencies = [0.15, 0.35]
    motion.amplitudes = {name: [0.2, 0.15] for name in motion.centre}
    motion.phases = dict(zip(motion.centre, ([-2.3, 0.4], [1.1, -1.9], [0.3, 2.8])))
    return World(scenario)


def only(joint: str, world: World) -> World:
    """One joint moves alone."""
    scenario = deepcopy(world.scenario)
    motion = scenario.joint_motion
    motion.amplitudes = {
        name: list(np.multiply(size, name == joint)) for name, size in motion.amplitudes.items()
    }
    return World(scenario)


def lower_arm(world: World) -> World:
    return only("capture_arm_joint2", world)


# -- several logs, priors, gaps -------------------------------------------------------------------


def two_logs(folder: Path) -> Rows:
    """Logs of two motions together, with an exact and with an uncertain spacecraft."""
    suite, rows = suite_of("flight"), {}
    bodies = load_scenario(shipped_scenario("uncertain_spacecraft")).known_bodies
    for name, seeds in (("two_logs", 3), ("two_logs_uncertain", 1)):
        trials, options = [], {"known_bodies": bodies} if "uncertain" in name else {}
        for seed in range(seeds):
            logs = {}
            for k, motion in enumerate(("exciting_motion", "paper")):
                scenario = load_scenario(shipped_scenario(motion))
                scenario.known_bodies = bodies
                world = World(scenario, np.random.default_rng([3, seed]) if options else None)
                path = log_of(world, suite, 10 * seed + k, folder / "log.parquet", hardware=seed)
                logs[motion] = read_log(path)
            found = identify(world.craft, logs, sensors=suite, **options)
            trials.append(trial_of(found, world))
        what = f"{name}: exciting_motion and paper together, flight, {seeds} seeds"
        rows[name] = row_of(what, trials)
    return rows


PRIOR = """
mass: 95
p_CTcm_C: [0.45, 0.01, 0]
I_TTcm_C: [[21, 0, 0], [0, 29, 0], [0, 0, 10.5]]
sigma: 0.1
"""


def prior(folder: Path) -> dict:
    """A motion that leaves the target open, completed by a prior."""
    world = lower_arm(world_of("exciting_motion"))
    log = log_of(world, suite_of("flight"), 1, folder / "log.parquet")
    (folder / "prior.yaml").write_text(PRIOR, encoding="utf-8")
    words = ["--sensors", suite_file(folder, "flight"), "--prior", folder / "prior.yaml"]
    return row_of("one joint moves, a prior of 10 %", [cli_trial(world, folder, log, *words)])


def gaps(folder: Path) -> dict:
    """A slow log with gaps in the joints and larger noise, as real ones have."""
    suite, trials, world = deepcopy(suite_of("air_bearing")), [], world_of("air_bearing")
    suite.encoders.rate = 5.0
    for seed in range(2):
        columns = load(log := log_of(world, suite, seed, folder / "log.parquet", noise=3.0))
        for start, length in ((6.0, 1.0), (14.0, 2.0), (21.0, 1.5), (29.0, 3.0)):
            lost = (columns["time"] > start) & (columns["time"] < start + length)
            for joint in world.craft.joint_names:
                columns[f"q:{joint}"][lost] = np.nan
        write_columns(log, columns)
        trials.append(identified(world, log, suite, **UNKNOWN))
    what = "air_bearing at 5 Hz, gaps of 1 to 3 s in the joints, noise of 3 σ, 2 seeds"
    return row_of(what, trials, is_spoiled=True, why=CAUGHT)


def load(log: Path) -> Columns:
    table = parquet.read_table(log)
    return {name: table[name].to_numpy().copy() for name in table.column_names}


# -- effects --------------------------------------------------------------------------------------

EFFECTS = {
    "attitude.delay_ms": 30.0,
    "gyro.delay_ms": 30.0,
    "position.delay_ms": 30.0,
    "encoders.delay_ms": 30.0,
    "attitude.mounting_arcsec": 360.0,
    "gyro.scale_ppm": 1000.0,
    "gyro.misalignment_arcsec": 200.0,
    "position.lever_arm_mm": 30.0,
    "encoders.zero_mrad": 2.0,
    "disturbances.acceleration": 1e-3,
    "disturbances.torque": 1e-2,
}
"""σ of every effect, in the units of its key; logged_burn has the scale of thrust."""

HIDDEN = {
    "encoders.zero_mrad": "zero",
    "gyro.misalignment_arcsec": "gyro",
    "position.lever_arm_mm": "point",
    "disturbances.acceleration": "accelerat|force",
    "attitude.delay_ms": "late|early|delay|clock",
}
"""Effects that are hidden, and words that name them."""


def with_effect(key: str, size: float) -> SensorSuite:
    suite, (sensor, _, name) = deepcopy(suite_of("flight")), key.partition(".")
    if sensor == "disturbances":
        suite.disturbances = replace(suite_of("flight_thrust").disturbances, thrust_scale=0.0)
    setattr(getattr(suite, sensor), name, size * EFFECTS[key])
    return suite


def declared(folder: Path) -> Rows:
    """Every effect at 1 σ, declared."""
    return {
        f"declared_{key}": monte_carlo(key, "exciting_motion", folder, with_effect(key, 1.0), 2)
        for key in EFFECTS
    }


def hidden(folder: Path) -> Rows:
    """Five effects at 3 σ that the sensors do not declare."""
    rows, fixed = {}, {"seeds": 2, "online": 0, "is_spoiled": True, "why": CAUGHT}
    for key, words in HIDDEN.items():
        true = with_effect(key, 3.0)
        what = f"{key} of 3 σ, hidden"
        rows[f"hidden_{key}"] = monte_carlo(
            what, "exciting_motion", folder, true=true, words=words, **fixed
        )
    return rows


# -- spoiled logs ---------------------------------------------------------------------------------


def scaled(factor: float, *prefixes: str) -> Callable[[Columns], Columns]:
    return lambda c: {n: v * factor if n.startswith(prefixes) else v for n, v in c.items()}


def exchanged(a: str, b: str) -> Callable[[Columns], Columns]:
    return lambda c: {**c, a: c[b], b: c[a]}


def shifted(name: str, offset: float) -> Callable[[Columns], Columns]:
    return lambda c: {**c, name: c[name] + offset}


def late_position(c: Columns) -> Columns:
    """Five samples of 10 ms."""
    moved = {n: np.append(np.full(5, np.nan), c[n][:-5]) for n in ("x", "y", "z")}
    return {**c, **moved}


def gyro_in_world(c: Columns) -> Columns:
    names, has = ("bwx", "bwy", "bwz"), np.isfinite(c["qw"])
    turns = Rotation.from_quat(np.stack([c[n][has] for n in ("qx", "qy", "qz", "qw")], axis=1))
    inside = np.clip(c["time"], c["time"][has][0], c["time"][has][-1])
    w = Slerp(c["time"][has], turns)(inside).apply(np.stack([c[n] for n in names], axis=1))
    return {**c, **dict(zip(names, w.T))}


ARM = "q:capture_arm_joint"
SPOILED: dict[str, tuple[str, Callable[[Columns], Columns], str]] = {
    "position_mm": ("exciting_motion", scaled(1e3, "x", "y", "z"), "millimet"),
    "time_ms": ("exciting_motion", scaled(1e3, "time"), "millisec|time"),
    "joints_degrees": ("exciting_motion", scaled(180 / np.pi, "q:"), "degree"),
    "quaternion_conjugate": ("exciting_motion", scaled(-1.0, "qx", "qy", "qz"), "quaternion|frame"),
    "gyro_in_world": ("tumbling_capture", gyro_in_world, "world|frame|axes"),
    "joint_sign": ("exciting_motion", scaled(-1.0, f"{ARM}4"), "sign"),
    "joints_exchanged": ("exciting_motion", exchanged(f"{ARM}2", f"{ARM}3"), "joint"),
    "joint_zero_5_deg": ("exciting_motion", shifted(f"{ARM}3", np.radians(5)), "joint|zero"),
    "position_late": ("free_flyer_payload", late_position, "late|delay|clock"),
    "payload_other_arm": ("exciting_motion", dict, "payload|body|model|mass"),
    "tumble_forgotten": ("tumbling_capture", dict, "momentum"),
    "noise_x5": ("exciting_motion", dict, "noise"),
}
"""Scenario, spoil and words that name the cause, of each spoiled log."""


def spoiled(folder: Path) -> Rows:
    """Twelve spoiled logs by `cpid identify`."""
    rows = {}
    for name, (scenario, spoil, words) in SPOILED.items():
        world, sensors = world_of(scenario), "testbed" if "flyer" in scenario else "flight"
        if name == "payload_other_arm":
            world.attach("operating_arm_gripper", 20.0, [0.3, 0.0, 0.0], 0.2)
        noise = 5.0 if name == "noise_x5" else 1.0
        log = log_of(world, suite_of(sensors), 1, folder / "log.parquet", noise=noise)
        write_columns(log, spoil(load(log)))
        options = ["--momentum", "zero"] if name == "tumble_forgotten" else []
        trial = cli_trial(world, folder, log, "--sensors", suite_file(folder, sensors), *options)
        what = f"{scenario}, {sensors}, {name}"
        rows[f"spoiled_{name}"] = row_of(what, [trial], is_spoiled=True, why=CAUGHT, words=words)
    return rows


# -- hardware -------------------------------------------------------------------------------------


def hardware(kind: str, *seeds: int) -> Callable[[Path], dict]:
    """Return a case of draws of simulated hardware (hardware_draws.py), by `cpid identify`."""

    def case(folder: Path) -> dict:
        trials = []
        for seed in seeds:
            draw = KINDS[kind](seed, folder / str(seed))
            names = {"model": draw.urdf, "base": "base", "capture_frame": "capture_point"}
            world = SimpleNamespace(
                target=InertialParameters.from_vector(draw.truth),
                craft=Spacecraft(draw.urdf, base="base", capture_frame="capture_point"),
                scenario=SimpleNamespace(spacecraft=SimpleNamespace(**names)),
            )
            words = "--sensors", draw.sensors, "--momentum", "unknown"
            trials.append(cli_trial(world, folder, draw.logs[0], *words))
        what = KINDS[kind].__doc__.splitlines()[0].rstrip(".")
        return row_of(f"{what}: draws {', '.join(map(str, seeds))}", trials)

    return case


# -- size -----------------------------------------------------------------------------------------


def hour(folder: Path) -> dict:
    """An hour at 100 Hz, by `cpid identify` with rows."""
    world = Repeated(load_scenario(shipped_scenario("exciting_motion")), 360)
    suite = deepcopy(suite_of("flight"))  # rounding would be the same in each repetition
    suite.encoders.sigma, suite.encoders.bits = 2 * np.pi / 2**20 / np.sqrt(12), 0
    log = log_of(world, suite, 1, folder / "log.parquet")
    trial = cli_trial(
        world,
        folder,
        log,
        "--sensors",
        suite_file(folder, "flight"),
        "--estimator",
        "least_squares",
    )
    return row_of("exciting_motion 360 times, flight, standard rows", [trial])


def million(folder: Path) -> dict:
    """A million rows of CSV with 12 digits: exact body rates and joints, repeated."""
    world, log = world_of("exciting_motion"), folder / "log.csv"
    m, joints = world.run(np.arange(1001) / 100), world.craft.joint_names
    names = ["time", "bwx", "bwy", "bwz", *(f"q:{j}" for j in joints), *(f"qd:{j}" for j in joints)]
    table = np.hstack([m["R"].inv().apply(m["w"]), m["q"], m["qdot"]])[:1000]
    period = [",".join(f"{x:.12g}" for x in row) for row in table.tolist()]
    with log.open("w", encoding="utf-8") as file:
        file.write(",".join(names) + "\n")
        file.writelines(f"{k / 100:.2f},{period[k % 1000]}\n" for k in range(1_000_000))
    trial = cli_trial(world, folder, log)
    figures = {"relative error": figure(trial.relative, at_most=1e-10)}
    what = "a million rows of CSV, 12 digits: body rates and joints, relative rows"
    return row_of(what, [trial], figures=figures, why=EXACT)


def plan(folder: Path) -> dict:
    """The σ of one plan."""
    small = ["--targets", "1", "--candidates", "200"]
    words = ["--sensors", suite_file(folder, "flight"), "--out", folder / "motion.yaml", *small]
    done = cli("plan", "motion", "paper", *words)
    [line] = [line for line in done.stdout.splitlines() if "worst σ, %" in line]
    own, found = map(float, re.findall(r"\d[\d.e-]*", line))
    figures = {
        "worst σ of the plan, %": figure(found, at_most=1.3 * found),
        "worst σ of the scenario's motion, %": figure(own, within=0.02),
    }
    why = "another search may end 1.3 times worse; the scenario's own σ is the same to 2 %"
    what = "cpid plan paper, flight, one target, 200 candidates"
    return row_of(what, [Trial(done.returncode)], figures=figures, why=why)


def run(what: str, name: str, *args, **options) -> Callable[[Path], dict]:
    """Return a case of one row by `monte_carlo`."""
    return lambda folder: monte_carlo(what, name, folder, *args, **options)


ALL = ("attitude", "gyro", "position", "encoders")
ARMS, WHEELS = "exciting_motion", "single_arm_wheels"
MANY = {"seeds": 20, "online": 3, "bound": True}
# fmt: off
CASES: dict[str, Callable[[Path], dict]] = {
    "exact": exact,
    "free_flyer_csv": free_flyer,
    "simulated_run": simulated,
    "prior": prior,
    "one_joint": run("one joint moves, flight", ARMS, seeds=1, change=lower_arm),
    "planar": run("a motion in a plane, flight", WHEELS, change=in_the_plane),
    "20_Hz": run("flight, encoders, gyro at 20 Hz", ARMS, at_rate(20.0, "encoders", "gyro")),
    "10_Hz": run("flight, all sensors at 10 Hz", ARMS, at_rate(10.0, *ALL)),
    "tumble_30": run("tumbling at 30°/s, flight", ARMS, change=tumbling, **UNKNOWN),
    "wheels": run("single_arm_wheels, servicer", WHEELS, "servicer", bound=True),
    "fast_wheels": run(
        "wheels at 3000 rpm, servicer", WHEELS, "servicer", change=with_fast_wheels, **UNKNOWN
    ),
    "thruster_firing": run(
        "a firing at 5 s, not logged, flight", "thruster_firing", seeds=4, change=fired, bound=True
    ),
    "logged_burn": run("logged_burn, flight_thrust", "logged_burn", "flight_thrust", 4, bound=True),
    "uncertain_spacecraft": run("flight", "uncertain_spacecraft", seeds=4, uncertain=True),
    "air_bearing": run("air_bearing", "air_bearing", "air_bearing", 4),
    "orbit": run("orbit", "orbit", "orbit", 1, online=0),
    "gaps_5_Hz": gaps,
    "hardware_valves": hardware("valves", 1, 2),
    "hardware_floor": hardware("floor", 0, 1),
    "hardware_pushed": hardware("pushed", 1),
    "two_logs": two_logs,
    "plan": plan,
    "paper_tables": paper,
    "hour_100_Hz": hour,
    "million_rows": million,
    "exciting_motion": run("exciting_motion, flight", "exciting_motion", **MANY),
    "paper_motion": run("paper, flight", "paper", **MANY),
    "tumbling_capture": run("tumbling_capture, flight", "tumbling_capture", **MANY),
    "hidden_effects": hidden,
    "spoiled_logs": spoiled,
    "declared_effects": declared,
}
# fmt: on
