"""Draws of simulated hardware logs, and what `cpid identify` says about them."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow
import yaml
from processes import finish, start
from pyarrow import parquet
from scipy.spatial.transform import Rotation
from worlds.hardware import ARCSEC, Array, Body, Craft, Joint, Valve, run, sines

X, Y, Z = np.eye(3)


@dataclass(eq=False)
class Draw:
    """Files of a draw, and its truth."""

    urdf: Path
    sensors: Path
    logs: list[Path]
    truth: Array
    dead: str = ""


def write(folder: Path, craft: Craft, sensors: dict, logs: list[dict], dead: str = "") -> Draw:
    """Write a model, its sensors and logs (columns by name)."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "craft.urdf").write_text(craft.urdf(), encoding="utf-8")
    (folder / "sensors.yaml").write_text(yaml.safe_dump(sensors, sort_keys=False), encoding="utf-8")
    paths = []
    for k, columns in enumerate(logs):
        paths.append(folder / f"log{k + 1}.parquet")
        parquet.write_table(pyarrow.table(columns), paths[-1])
    truth = craft.target.parameters()
    return Draw(folder / "craft.urdf", folder / "sensors.yaml", paths, truth, dead)


def samples(rng, craft: Craft, times, found, q, sigma_m, sigma_rad, sigma_q, zero) -> dict:
    """Return the columns of motion capture of pose and joints, with noise [m, rad]."""
    n, noise = len(times), rng.standard_normal
    p = found["p"] + sigma_m * noise((n, 3))
    columns = {"time": times}
    turn = Rotation.from_quat(found["quat"], scalar_first=True)
    if craft.planar:
        yaw = np.unwrap(turn.as_euler("ZYX")[:, 0]) + sigma_rad * noise(n)
        columns |= {"x": p[:, 0], "y": p[:, 1], "yaw": yaw}
    else:
        quat = (turn * Rotation.from_rotvec(sigma_rad * noise((n, 3)))).as_quat(scalar_first=True)
        columns |= dict(zip(("qw", "qx", "qy", "qz"), quat.T)) | dict(zip("xyz", p.T))
    for k, joint in enumerate(craft.joints):
        columns[f"q:{joint.name}"] = q[:, k] + zero[k] + sigma_q * noise(n)
    return columns


def pose_sensors(rate, sigma_m, sigma_rad) -> dict:
    arc = float(sigma_rad / ARCSEC)
    return {
        "attitude": {"rate": rate, "cross_boresight_arcsec": arc, "boresight_arcsec": arc},
        "position": {"rate": rate, "sigma": float(sigma_m)},
    }


def inside(rng, valves: list[Valve], rate: float, mass: float):
    """Return a command: random pulses of 0.2 to 1 s of one or two valves, then a pause."""
    u, until = np.zeros(len(valves)), 0
    force = np.array([v.force * v.direction for v in valves])
    moment = np.array([np.cross(v.position, f) for v, f in zip(valves, force)])

    def command(row: int, now: dict) -> Array:
        nonlocal u, until
        if row < until:
            return u
        if u.any():
            u, until = np.zeros(len(valves)), row + round(rate * rng.uniform(0.1, 0.6))
            return u
        length, R, state = rng.uniform(0.2, 1.0), now["R"], now["state"]
        turn = Rotation.from_matrix(R).as_rotvec()
        best = np.inf
        for _ in range(6):
            tried = np.zeros(len(valves))
            tried[rng.choice(len(valves), rng.integers(1, 3), replace=False)] = 1.0
            wrench = np.concatenate([tried @ moment, tried @ force]) * length
            change = np.linalg.solve(now["M"], wrench)
            w, v = now["V"][:3] + change[:3], R @ (now["V"][3:] + change[3:])
            cost = np.sum((state[4:7] + 8 * v) ** 2) + 0.3 * np.sum((turn + 8 * w) ** 2)
            if cost < best:
                best, u = cost, tried
        until = row + max(1, round(rate * length))
        return u

    return command


def valves(seed: int, folder: Path, *, declared: bool = True) -> Draw:
    """A platform with on/off valves and no arm; one valve is dead, thrust is late."""
    rng = np.random.default_rng([12, 1, seed])
    planar, joint = seed % 2 == 0, bool(seed // 2 % 2)
    mass, share = rng.uniform(8, 40), rng.uniform(0.3, 0.8)
    base = Body.drawn(rng, (1 - share) * mass, 0.35, 0.02 * rng.standard_normal(3))
    target = Body.drawn(
        rng, share * mass, 0.3, [rng.uniform(0.05, 0.2), *0.04 * rng.standard_normal(2)]
    )
    arm = [
        Joint(
            "hinge", "revolute", Z, np.array([0.18, 0, 0]), Body.drawn(rng, 0.3, 0.08, np.zeros(3))
        )
    ]
    capture = np.array([0.2, 0.0, 0.0])
    craft = Craft(base, target, arm if joint else [], capture, planar)
    count = int(rng.integers(4, 13)) if planar else int(rng.integers(8, 13))
    corners, fitted = rng.permutation(count), []
    for k in range(count):
        i = int(corners[k])
        axis = np.roll([1.0 if i // 2 % 2 else -1.0, 0, 0], i % 2 if planar else i % 3)
        place = rng.uniform(-0.25, 0.25, 3)
        if planar:  # couples of both senses: beside the common centre of mass
            place[2] = 0.0
        fitted.append(Valve(place, axis, rng.uniform(0.2, 1.0), 1 + 0.05 * rng.standard_normal()))
    dead = int(rng.integers(count))
    fitted[dead].share = 0.0
    rate, duration = float(rng.choice([10.0, 12.5, 16.0, 20.0])), rng.uniform(40, 120)
    delay, loss = rng.uniform(0.03, 0.2), rng.uniform(0, 0.1)
    white = rng.uniform(0.5e-3, 3e-3)
    floor = white, white * mass * 0.2
    sigma_m, sigma_rad = rng.uniform(0.5e-3, 2e-3), rng.uniform(1e-3, 3e-3)
    times = np.arange(int(duration * rate)) / rate
    angle = rng.uniform(-1, 1) * joint

    def rest(t):
        return np.full((len(t), int(joint)), angle), np.zeros((len(t), int(joint)))

    found = run(craft, times, rest, rng, valves=fitted, delay=delay, loss=loss, floor=floor,
                command=inside(rng, fitted, rate, mass))  # fmt: skip
    columns = samples(rng, craft, times, found, rest(times)[0], sigma_m, sigma_rad, 1e-4, [0.0])
    columns |= {f"valve:v{k + 1}": found["opening"][:, k] for k in range(count)}
    sensors = pose_sensors(rate, sigma_m, sigma_rad)
    if joint:
        sensors["encoders"] = {"rate": rate, "sigma": 1e-4}
    if seed % 3 == 0 and not planar:
        sensors["gyro"] = {
            "rate": rate,
            "angle_random_walk": 0.3,
            "bias": 60.0,
            "bias_random_walk": 1.0,
        }
        w = found["w_B"] + 60 * ARCSEC * rng.standard_normal(3)
        w = w + np.radians(0.3) / 60 * np.sqrt(rate) * rng.standard_normal(w.shape)
        columns |= dict(zip(("bwx", "bwy", "bwz"), w.T))
    thrusters = {"valves": {}}
    for k, valve in enumerate(fitted):
        place, axis = ([float(x) for x in v] for v in (valve.position, valve.direction))
        entry = {"position": place, "direction": axis, "force": float(valve.force)}
        if declared:
            entry["force_sigma"] = float(0.05 * valve.force)
        thrusters["valves"][f"v{k + 1}"] = entry
    if declared:
        thrusters = {"delay_ms": 150.0, "loss": 0.1, **thrusters}
        a, t = map(float, floor)
        sensors["disturbances"] = {"acceleration_noise": a, "torque_noise": t}
    sensors["thrusters"] = thrusters
    return write(folder, craft, sensors, [columns], f"v{dead + 1}")


def floor(seed: int, folder: Path, *, logs: int = 1, step: float = 0.0) -> Draw:
    """An arm on a table, seen at 5 Hz with gaps; noise three times the declared one."""
    rng = np.random.default_rng([12, 2, seed])
    base = Body.drawn(rng, rng.uniform(6, 15), 0.35, np.zeros(3))
    target = Body.drawn(
        rng, rng.uniform(2, 8), 0.25, [rng.uniform(0.05, 0.2), *0.03 * rng.standard_normal(2)]
    )
    lengths = rng.uniform(0.2, 0.35, int(rng.integers(2, 4)))
    joints, place = [], np.array([0.2, 0.0, 0.0])
    for k, length in enumerate(lengths):
        link = Body.drawn(rng, rng.uniform(0.4, 1.5), 0.12, [length / 2, 0, 0])
        joints.append(Joint(f"joint{k + 1}", "revolute", Z, place, link))
        place = np.array([length, 0.0, 0.0])
    craft = Craft(base, target, joints, place, planar=True)
    mass = base.mass + target.mass + sum(j.body.mass for j in joints)
    acceleration = rng.uniform(0.3e-3, 2e-3)
    noise = acceleration, acceleration * mass * 0.2
    sigma_m, sigma_rad, sigma_q = rng.uniform(0.5e-3, 1e-3), rng.uniform(1e-3, 2e-3), 2e-3
    zero, rate, columns = 1e-2 * rng.standard_normal(len(joints)), 5.0, []
    for number in range(logs):
        times = np.arange(int(rng.uniform(40, 60) * rate)) / rate
        motion = sines(rng, rng.uniform(0.4, 0.9, len(joints)), 0.04, 0.15)
        start = np.array([0, 0, 0.02 * rng.standard_normal(), *0.1 * rng.standard_normal(2), 0])
        when, long = 0.6 * times[-1], 1.0

        def push(t, last=number == logs - 1, when=when, long=long):
            ahead = np.sign(long / 2 - (t - when)) if 0 <= t - when < long else 0.0
            return X * last * ahead * 4 * step / long**2

        found = run(craft, times, motion, rng, momentum=start, floor=noise, push=push)
        log = samples(
            rng,
            craft,
            times,
            found,
            motion(times)[0],
            3 * sigma_m,
            3 * sigma_rad,
            3 * sigma_q,
            zero,
        )
        for _ in range(int(rng.integers(2, 6))):
            t = rng.uniform(3, times[-1] - 6)
            gone = (times > t) & (times < t + rng.uniform(1, 3))
            names = [n for n in log if n.startswith("q:")]
            names += ["x", "y", "yaw"] if rng.random() < 0.5 else []
            for name in names:
                log[name] = np.where(gone, np.nan, log[name])
        columns.append(log)
    sensors = pose_sensors(rate, sigma_m, sigma_rad)
    sensors["encoders"] = {"rate": rate, "sigma": sigma_q, "zero_mrad": 10.0}
    sensors["disturbances"] = dict(zip(("acceleration_noise", "torque_noise"), map(float, noise)))
    return write(folder, craft, sensors, columns)


def pushed(seed: int, folder: Path) -> Draw:
    """A captured body, measured relative to the base, and thrust along W's axes in every row."""
    rng = np.random.default_rng([12, 3, seed])
    planar, on = bool(seed % 2), ("target", "body")[seed // 2 % 2]
    base = Body.drawn(rng, rng.uniform(5, 20), 0.35, 0.02 * rng.standard_normal(3))
    target = Body.drawn(rng, rng.uniform(5, 20), 0.35, 0.04 * rng.standard_normal(3))
    names = ("x", "y", "yaw") if planar else ("x", "y", "z", "yaw", "pitch", "roll")
    axes = {"x": X, "y": Y, "z": Z, "yaw": Z, "pitch": Y, "roll": X}
    joints = [
        Joint(n, "prismatic" if n in "xyz" else "revolute", axes[n], np.zeros(3)) for n in names
    ]
    joints[0].origin = np.array([0.45, 0.0, 0.0])
    craft = Craft(base, target, joints, np.zeros(3), planar)
    mass = base.mass + target.mass
    size = np.array([0.03 if n in "xyz" else 0.1 for n in names])
    motion = sines(rng, size, 0.03, 0.12)
    rate, duration = float(rng.choice([10.0, 16.0, 25.0, 50.0])), rng.uniform(15, 60)
    times = np.arange(int(duration * rate)) / rate
    width = 2 if planar else 3
    place = 0.1 * rng.standard_normal(3) * ([1, 1, 0] if planar else 1)
    share = 1 + 0.05 * rng.standard_normal((width, 2))  # each is off by itself, as declared
    fitted = [
        Valve(place, sign * np.eye(3)[k], 1.0, share[k, j], on, "world")
        for k in range(width)
        for j, sign in enumerate((1, -1))
    ]
    phase, speed = rng.uniform(0, 6.28, (width, 2)), rng.uniform(0.3, 1.5, (width, 2))
    force = mass * rng.uniform(0.005, 0.02, width)

    def command(row, now):
        wave = np.sin(speed * times[row] + phase).sum(axis=1)
        back = 0.05 * now["state"][4:7] + 0.3 * (now["R"] @ now["V"][3:])
        wanted = force * wave - mass * 0.1 * back[:width]
        return np.stack([np.maximum(wanted, 0), np.maximum(-wanted, 0)], axis=1).ravel()

    white = rng.uniform(0.5e-3, 2e-3)
    noise, delay = (white, white * mass * 0.2), rng.uniform(0.0, 0.1)
    sigma_m, sigma_rad = rng.uniform(0.5e-3, 2e-3), rng.uniform(1e-3, 3e-3)
    found = run(craft, times, motion, rng, valves=fitted, delay=delay, floor=noise, command=command)
    columns = samples(
        rng, craft, times, found, motion(times)[0], sigma_m, sigma_rad, 1.5e-3, np.zeros(6)
    )
    names = [f"{sign}{'xyz'[k]}" for k in range(width) for sign in ("plus_", "minus_")]
    columns |= {f"valve:{name}": u for name, u in zip(names, found["opening"].T)}
    sensors = pose_sensors(rate, sigma_m, sigma_rad) | {"encoders": {"rate": rate, "sigma": 1.5e-3}}
    sensors["disturbances"] = dict(zip(("acceleration_noise", "torque_noise"), map(float, noise)))
    valve = {
        "force": 1.0,
        "force_sigma": 0.05,
        "on": on,
        "axes": "world",
    }
    entries = {  # each with a list of its own: YAML would write one as an alias
        n: {**valve, "position": place.tolist(), "direction": v.direction.tolist()}
        for n, v in zip(names, fitted)
    }
    sensors["thrusters"] = {"delay_ms": 100.0, "valves": entries}
    return write(folder, craft, sensors, [columns])


def identified(draw: Draw, *words: str) -> dict:
    """Return what `cpid identify` says about a draw, compared with the truth."""
    out = draw.urdf.with_name("found.json")
    out.unlink(missing_ok=True)
    craft = "--model", draw.urdf, "--base", "base", "--capture-frame", "capture_point"
    command = "identify", *draw.logs, *craft, "--sensors", draw.sensors, "--json", out, *words
    done = finish(start("-m", "cpid_drake", *command, cwd=draw.urdf.parent))
    text = done.stderr + done.stdout
    row = {"code": done.returncode, "text": text, "known": 0, "worst": np.nan, "changes": 0}
    row["named"] = not draw.dead or f"{draw.dead} " in text.replace(",", " ").replace(":", " ")
    if out.exists():
        found = json.loads(out.read_text(encoding="utf-8"))
        estimate, intervals = (np.array(found[k], dtype=float) for k in ("parameters", "intervals"))
        sigma = np.diff(intervals, axis=1)[:, 0] / 2 / 1.959964
        known = np.isfinite(estimate)
        row |= {"known": int(known.sum()), "changes": len(found.get("momentum_changes") or [])}
        if known.any():
            off = (estimate - draw.truth)[known]
            row["worst"] = float(np.abs(off / sigma[known]).max())
            row["relative"] = float(sigma[0] / draw.truth[0])
            # Parameters of one draw err together: NEES of n known ones is χ² with n degrees.
            both = np.array(found["covariance"], dtype=float)[np.ix_(known, known)]
            row["nees"] = float(off @ np.linalg.solve(both, off))
    return row
