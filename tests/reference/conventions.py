"""Logs in wrong conventions, drawn at random: is the convention named, and is no answer wrong?

python tests/reference/conventions.py [--draws 0 1] [--scenarios free_flyer_payload ...]

Every draw spoils a log in each of the ways below, with a joint, an axis or a unit drawn at random,
and identifies the target from it. The table says how many logs have exit code 0 (or 3) and an
interval that misses the truth by much, and how many have a message that names the convention.
"""

import argparse
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from cases import Columns, gyro_in_world, world_of
from logs import log_of
from rows import cli_trial, suite_file, suite_of
from scipy.spatial.transform import Rotation

PLACE, GYRO, QUATERNION = ("x", "y", "z"), ("bwx", "bwy", "bwz"), ("qw", "qx", "qy", "qz")
Spoil = Callable[[Columns, np.random.Generator], tuple[Columns, str]]


def joints_of(c: Columns) -> list[str]:
    return [name[2:] for name in c if name.startswith("q:") and np.nanstd(c[name]) > 1e-3]


def scaled(c: Columns, names: tuple[str, ...], size: float) -> Columns:
    return {**c, **{name: size * c[name] for name in names if name in c}}


def place_unit(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    unit, size = list({"mm": 1e3, "cm": 1e2, "in": 1 / 0.0254, "ft": 1 / 0.3048}.items())[
        rng.integers(4)
    ]
    return scaled(c, PLACE, size), f"position.unit: {unit}"


def gyro_unit(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    unit, size = [("deg/s", 180 / np.pi), ("rpm", 30 / np.pi)][rng.integers(2)]
    return scaled(c, GYRO, size), f"angular_velocity.unit: {unit}"


def clock_unit(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    unit, size = [("ms", 1e3), ("us", 1e6), ("ns", 1e9)][rng.integers(3)]
    return scaled(c, ("time",), size), f"time.unit: {unit}|must be in s|in ns"


def all_degrees(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    return scaled(c, tuple(n for n in c if n.startswith("q") and ":" in n), 180 / np.pi), "degrees"


def one_degrees(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    joint = rng.choice(joints_of(c))
    names = (f"q:{joint}", f"qd:{joint}")
    return scaled(c, names, 180 / np.pi), f"{joint}.*degrees"


def joint_sign(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    joint = rng.choice(joints_of(c))
    return scaled(c, (f"q:{joint}", f"qd:{joint}"), -1.0), f"{joint} has the opposite sign"


def exchanged(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    a, b = rng.choice(joints_of(c), 2, replace=False)
    swapped = {}
    for kind in ("q:", "qd:"):
        if kind + a in c:
            swapped |= {kind + a: c[kind + b], kind + b: c[kind + a]}
    return {**c, **swapped}, f"({a}|{b}).*exchanged"


def reordered(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    return {**c, **dict(zip(QUATERNION, [c[n] for n in ("qx", "qy", "qz", "qw")]))}, "order: xyzw"


def inverse(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    return scaled(c, QUATERNION[1:], -1.0), "direction: R_BW"


def both(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    return reordered(inverse(c, rng)[0], rng)[0], "order: xyzw"


def in_world(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    return gyro_in_world(c), "angular_velocity.frame: world|expressed in w"


def gyro_axes(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    order, signs = rng.permutation(3), rng.choice([-1.0, 1.0], 3)
    if (order == range(3)).all() and (signs > 0).all():
        signs[0] = -1.0
    turned = {GYRO[k]: signs[k] * c[GYRO[order[k]]] for k in range(3)}
    return {**c, **turned}, "gyro has other axes"


def tracker_axes(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    turn = Rotation.from_euler("xyz", np.pi / 2 * rng.integers(1, 4, 3))
    has = np.isfinite(c["qw"])
    R = Rotation.from_quat(np.stack([c[n][has] for n in QUATERNION], axis=1), scalar_first=True)
    quaternions = {n: c[n].copy() for n in QUATERNION}
    for name, value in zip(QUATERNION, (R * turn).as_quat(scalar_first=True).T):
        quaternions[name][has] = value
    w = turn.apply(np.stack([c[n] for n in GYRO], axis=1), inverse=True)
    return {**c, **quaternions, **dict(zip(GYRO, w.T))}, "attitude and angular velocity belong"


def place_axes(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    k = rng.integers(1, 3)
    turned = {PLACE[i]: c[PLACE[(i + k) % 3]] for i in range(3)}
    return {**c, **turned}, "position is expressed in other axes"


def marker(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    has = np.isfinite(c["qw"]) & np.isfinite(c["x"])
    R = Rotation.from_quat(np.stack([c[n][has] for n in QUATERNION], axis=1), scalar_first=True)
    moved = {n: c[n].copy() for n in PLACE}
    for name, value in zip(PLACE, R.apply(rng.uniform(-0.5, 0.5, 3)).T):
        moved[name][has] += value
    for name in PLACE:
        moved[name][~has] = np.nan
    return {**c, **moved}, "that of the point|lever"


def late_gyro(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    late, has = {}, np.isfinite(c["bwx"])
    delay = rng.uniform(0.05, 0.15)
    for name in GYRO:
        late[name] = c[name].copy()
        late[name][has] = np.interp(c["time"][has] - delay, c["time"][has], c[name][has])
    return {**c, **late}, "delay|late"


def counted_steps(c: Columns, rng: np.random.Generator) -> tuple[Columns, str]:
    return scaled(c, ("time",), 1 / rng.uniform(1.03, 1.1)), "clock"


SPOILS: tuple[Spoil, ...] = (
    *(place_unit, gyro_unit, clock_unit, all_degrees, one_degrees, joint_sign, exchanged),
    *(reordered, inverse, both, in_world, gyro_axes, tracker_axes, place_axes, marker),
    *(late_gyro, counted_steps),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, nargs="+", default=[0])
    names = ["free_flyer_payload", "exciting_motion"]
    parser.add_argument("--scenarios", nargs="+", default=names)
    given = parser.parse_args()
    wrong = named = count = 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for scenario in given.scenarios:
            world, sensors = world_of(scenario), "testbed" if "flyer" in scenario else "flight"
            for draw in given.draws:
                log = log_of(world, suite_of(sensors), draw + 1, folder / "log.npz")
                with np.load(log) as file:
                    right = dict(file)
                for k, spoil in enumerate(SPOILS):
                    columns, words = spoil(right, np.random.default_rng([draw, k]))
                    np.savez(log, **columns)
                    trial = cli_trial(world, folder, log, "--sensors", suite_file(folder, sensors))
                    is_named = bool(re.search(words.lower(), trial.text.lower()))
                    count, named, wrong = count + 1, named + is_named, wrong + trial.is_wrong
                    state = "WRONG" if trial.is_wrong else f"exit {trial.code}"
                    line = f"{scenario:20} {draw} {spoil.__name__:14} {state:8}"
                    print(f"{line} {'named' if is_named else 'not named'}", flush=True)
                    if not is_named or trial.is_wrong:
                        print("     ", " ".join(trial.text.split())[:300], flush=True)
    print(f"{count} logs: {wrong} confidently wrong, {named} named")


if __name__ == "__main__":
    main()
