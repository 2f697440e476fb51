"""True motions and noisy logs for the reference table, independent of the package's simulation.

The base moves as the momentum demands: its velocity solves h = M(q) v with the mass matrix of
Drake's plant, integrated by the method of Runge and Kutta of fourth order. The errors of sensors
follow from the definitions of the keys of their files (models/README.md). A seed determines them,
so that a row of the table can be compared estimate by estimate.
"""

from collections.abc import Sequence
from copy import copy
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow
from numpy.typing import NDArray
from pyarrow import parquet
from pydrake.multibody.tree import BodyIndex, RotationalInertia, SpatialInertia
from scipy.spatial.transform import Rotation

from cpid_drake import Scenario, SensorSuite, make_simulation

Array = NDArray[np.float64]

ARCSEC = DEGREE_HOUR = np.pi / 648000
EARTH, EARTH_RADIUS = 3.986004418e14, 6378.137e3
STEP = 0.02
"""Longest step of the integration [s]."""

WALK = 0.5
"""Random walks of disturbances change in steps of this length [s], as in the Diagram."""

THRUST = ("thrust_tx", "thrust_ty", "thrust_tz", "thrust_fx", "thrust_fy", "thrust_fz")


class World:
    """A scenario's spacecraft and target as Drake's plant, and what moves them [SI units].

    Attributes:
        motion: of the joints.
        momentum: (6,) [L; P] about W's origin at the start.
        disturbance: (K, 6) torque about the common centre of mass and acceleration of this centre,
            in W, one row for each `WALK` of time; the last one lasts. None for none.
        thrust: burns (start, end, (6,) torque about B's origin and force in B).
        kicks: impulses (time, (6,) momentum about W's origin).
        orbit: mean motion, and directions of nadir and normal in W; None for none.

    Args:
        scenario: the scenario.
        rng: draws errors of all bodies of the size of the scenario's `known_bodies`; None for none.

    """

    def __init__(self, scenario: Scenario, rng: np.random.Generator | None = None) -> None:
        simulation = make_simulation(scenario)
        self.scenario, self.plant = scenario, simulation.plant
        self.craft, self.target = simulation.spacecraft, simulation.truth
        self.motion, self.duration = simulation.joint_motion, scenario.simulation.duration
        self.momentum = np.asarray(scenario.simulation.momentum_W, dtype=float)
        self.planar = scenario.spacecraft.on_table
        self.disturbance, self.orbit, self.kicks = None, None, ()
        burns = scenario.simulation.burns
        self.thrust = tuple((b.time, b.time + b.duration, _wrench(b)) for b in burns)
        self._known: dict[bytes, dict] = {}  # the last motion: seeds without forces share it
        self._context = self.plant.CreateDefaultContext()
        joints = [self.plant.GetJointByName(name) for name in self.craft.joint_names]
        self._q, self._v = (
            [getattr(j, f"{x}_start")() for j in joints] for x in ("position", "velocity")
        )
        if rng is not None:
            base = self.plant.GetBodyByName(scenario.spacecraft.base)
            seen = {
                self.plant.world_body().index(),
                self.plant.GetBodyByName("captured_target").index(),
            }
            for body in (base, *(joint.child_body() for joint in joints)):
                group = [b for b in self.plant.GetBodiesWeldedTo(body) if b.index() not in seen]
                seen |= {b.index() for b in group}
                self._perturb(body, group, rng)

    def _perturb(self, body, group: list, rng: np.random.Generator) -> None:
        """Draw errors of the inertia of welded bodies, which `body` then has alone."""
        sizes, context = self.scenario.known_bodies, self._context
        indices = [b.index() for b in group]
        whole = self.plant.CalcSpatialInertia(context, body.body_frame(), indices)
        mass, com = whole.get_mass(), whole.get_com()
        inertia = whole.Shift(com).CalcRotationalInertia().CopyToFullMatrix3()
        mass *= 1 + sizes.mass * rng.standard_normal()
        com = com + sizes.com * rng.standard_normal(3)
        stretch = np.zeros((3, 3))
        stretch[np.triu_indices(3)] = sizes.inertia / 2 * rng.standard_normal(6)
        stretch = np.eye(3) + stretch + np.triu(stretch, 1).T
        second = stretch @ (np.trace(inertia) / 2 * np.eye(3) - inertia) @ stretch.T
        inertia = np.trace(second) * np.eye(3) - second
        about_com = RotationalInertia(*np.diag(inertia), *inertia[[0, 0, 1], [1, 2, 2]])
        for other in group:
            other.SetSpatialInertiaInBodyFrame(context, SpatialInertia.Zero())
        drawn = SpatialInertia.MakeFromCentralInertia(mass, com, about_com)
        body.SetSpatialInertiaInBodyFrame(context, drawn)

    def attach(self, name: str, mass: float, place: Sequence[float], radius: float) -> None:
        """Fix a solid sphere, which the model does not have, on a body."""
        body, moment = self.plant.GetBodyByName(name), 0.4 * mass * radius**2
        sphere = RotationalInertia(moment, moment, moment)
        whole = body.CalcSpatialInertiaInBodyFrame(self._context)
        whole += SpatialInertia.MakeFromCentralInertia(mass, np.array(place), sphere)
        body.SetSpatialInertiaInBodyFrame(self._context, whole)

    def velocities(self, q: Array, qdot: Array, state: Array) -> tuple[Array, Array, float]:
        """Return [w_WB; v_WB], the position of the centre of mass in W, and the mass."""
        positions, (p, L, P) = np.empty(self.plant.num_positions()), np.split(state[4:], 3)
        positions[:7], positions[self._q] = state[:7], q
        positions[:4] /= np.linalg.norm(state[:4])
        self.plant.SetPositions(self._context, positions)
        M = self.plant.CalcMassMatrix(self._context)
        h = np.concatenate([L - np.cross(p, P), P]) - M[:6, self._v] @ qdot
        V, rows = np.zeros(6), [2, 3, 4] if self.planar else list(range(6))
        V[rows] = np.linalg.solve(M[np.ix_(rows, rows)], h[rows])
        return V, p + np.array([M[2, 4], M[0, 5], M[1, 3]]) / M[5, 5], M[5, 5]

    def spinning(self, w_WB: Array, v_WScm: Array) -> Array:
        """Return the momentum [L; P] with which base and centre of mass move so at the start."""
        q, qdot, _ = self.motion.evaluate(0.0)
        pose = np.concatenate([[1.0], np.zeros(6)])
        still, _, mass = self.velocities(q, qdot, np.append(pose, np.zeros(6)))
        response = np.array(
            [self.velocities(q, qdot, np.append(pose, unit))[0] - still for unit in np.eye(6)]
        ).T
        P = mass * np.asarray(v_WScm)
        L = np.linalg.solve(response[:3, :3], w_WB - still[:3] - response[:3, 3:] @ P)
        return np.concatenate([L, P])

    def run(self, times: Array) -> dict:
        """Return the true motion at increasing times from 0: R (R_WB), p, w, v in W, q, qdot."""
        key = times.tobytes()
        if self.disturbance is None and key in self._known:
            return self._known[key]
        edges = [t for start, end, _ in self.thrust for t in (start, end)]
        edges += [time for time, _ in self.kicks]
        if self.disturbance is not None:
            edges += list(WALK * np.arange(1, len(self.disturbance)))
        grid = np.unique(np.concatenate([[0.0], times, [e for e in edges if e < times[-1]]]))
        parts = (
            np.linspace(a, b, int(np.ceil((b - a) / STEP)) + 1)[:-1] for a, b in pairwise(grid)
        )
        grid = np.append(np.concatenate([*parts]), grid[-1])
        middle = (grid[:-1] + grid[1:]) / 2
        at_grid, at_middle = self.motion.evaluate(grid), self.motion.evaluate(middle)
        states = [np.concatenate([[1.0], np.zeros(6), self.momentum])]
        kicks = list(self.kicks)
        for k, h in enumerate(np.diff(grid)):
            state, inside = states[-1], middle[k]  # forces are constant within a step
            while kicks and kicks[0][0] <= grid[k] + 1e-9:
                state = state + np.append(np.zeros(7), kicks.pop(0)[1])
            k1 = self._rate(grid[k], inside, at_grid[k], state)
            k2 = self._rate(inside, inside, at_middle[k], state + h / 2 * k1)
            k3 = self._rate(inside, inside, at_middle[k], state + h / 2 * k2)
            k4 = self._rate(grid[k + 1], inside, at_grid[k + 1], state + h * k3)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            state[:4] /= np.linalg.norm(state[:4])
            states.append(state)
        kept = np.searchsorted(grid, times)
        state, q, qdot = np.array(states)[kept], at_grid[kept, 0], at_grid[kept, 1]
        for time, kick in self.kicks:  # a sample at the instant of a kick is after it
            state[np.isclose(times, time), 7:] += kick
        V = np.array([self.velocities(*each)[0] for each in zip(q, qdot, state)])
        R = Rotation.from_quat(state[:, :4], scalar_first=True)
        found = {"R": R, "p": state[:, 4:7], "w": V[:, :3], "v": V[:, 3:], "q": q, "qdot": qdot}
        self._known = {key: found} if self.disturbance is None else {}
        return found

    def _rate(self, time: float, inside: float, joints: Array, state: Array) -> Array:
        V, com, mass = self.velocities(joints[0], joints[1], state)
        w, x, y, z = state[:4]
        turn = np.array([[-x, -y, -z], [w, z, -y], [-z, w, x], [y, -x, w]]) @ V[:3] / 2
        torque, force = np.zeros(3), np.zeros(3)  # about W's origin
        if self.disturbance is not None:
            each = self.disturbance[min(int(inside / WALK), len(self.disturbance) - 1)]
            force = mass * each[3:]
            torque = each[:3] + np.cross(com, force)
        for start, end, wrench in self.thrust:
            if start < inside < end:
                R_WB = Rotation.from_quat(state[:4], scalar_first=True)
                pushed = R_WB.apply(wrench[3:])
                force = force + pushed
                torque = torque + R_WB.apply(wrench[:3]) + np.cross(state[4:7], pushed)
        if self.orbit is not None:  # the tide 3 n² (u uᵀ - 1/3) at each mass
            n, nadir, normal = self.orbit
            u = np.cos(n * time) * nadir + np.sin(n * time) * np.cross(normal, nadir)
            bodies = [BodyIndex(i) for i in range(1, self.plant.num_bodies())]
            whole = self.plant.CalcSpatialInertia(self._context, self.plant.world_frame(), bodies)
            inertia = whole.CalcRotationalInertia().CopyToFullMatrix3()
            second = np.trace(inertia) / 2 * np.eye(3) - inertia
            force = force + mass * n**2 * (3 * u * (u @ com) - com)
            torque = torque + 3 * n**2 * np.cross(second @ u, u)
        return np.concatenate([turn, V[3:], torque, force])


class Repeated(World):
    """A world with zero momentum whose motion, at rest at both ends, is repeated."""

    def __init__(self, scenario: Scenario, repetitions: int) -> None:
        super().__init__(scenario)
        self._period, self._count = self.duration, repetitions
        self.duration *= repetitions

    def run(self, times: Array) -> dict:
        """See `World.run`; each repetition turns and moves the base by the same amount."""
        number = np.floor(times / self._period + 1e-9).astype(int)
        inside, place = np.unique((times - number * self._period).round(9), return_inverse=True)
        m = super().run(np.append(inside, self._period))
        R, p = [Rotation.identity()], [np.zeros(3)]
        for _ in range(self._count):
            p.append(p[-1] + R[-1].apply(m["p"][-1]))
            R.append(R[-1] * m["R"][-1])
        R_WV = Rotation.concatenate(R)[number]
        turned = {name: R_WV.apply(m[name][place]) for name in ("p", "w", "v")}
        turned["p"] += np.array(p)[number]
        return {"R": R_WV * m["R"][place], **turned, "q": m["q"][place], "qdot": m["qdot"][place]}


def log_of(world: World, suite: SensorSuite, seed: int, path: Path, *, hardware: int | None = None,
           noise: float = 1.0) -> Path:  # fmt: skip
    """Write the samples of the sensors as columns to a Parquet file, and return its path."""
    rng = np.random.default_rng([1, seed])
    fixed = np.random.default_rng([2, seed if hardware is None else hardware])
    scale = _draw_forces(world, suite, rng)
    sensors = {n: getattr(suite, n) for n in ("attitude", "gyro", "position", "encoders")}
    sensors = {name: _stated(sensor) for name, sensor in sensors.items() if sensor is not None}
    true = {
        name: np.arange(int(world.duration * sensor.rate + 1e-9) + 1) / sensor.rate
        for name, sensor in sensors.items()
    }
    integrates = suite.gyro is not None and suite.gyro.integrates
    middles = true["gyro"][1:] - 0.5 / suite.gyro.rate if integrates else np.zeros(0)
    grid = np.unique(np.concatenate([*true.values(), middles]).round(9))
    motion = world.run(grid)
    w_B, series = motion["R"].inv().apply(motion["w"]), {}
    for name, sensor in sensors.items():
        at, times = np.searchsorted(grid, true[name].round(9)), true[name]
        delay = 1e-3 * sensor.delay_ms * fixed.standard_normal()
        if name == "attitude":
            assert np.array_equal(sensor.boresight_B, [0, 0, 1])
            cross, about = sensor.cross_boresight_arcsec, sensor.boresight_arcsec
            error = noise * ARCSEC * rng.standard_normal((len(at), 3)) * [cross, cross, about]
            mounting = ARCSEC * sensor.mounting_arcsec * fixed.standard_normal(3)
            turned = motion["R"][at] * Rotation.from_rotvec(mounting) * Rotation.from_rotvec(error)
            columns, value = ("qw", "qx", "qy", "qz"), turned.as_quat(scalar_first=True)
        elif name == "gyro":
            columns, value = ("bwx", "bwy", "bwz"), w_B[at]
            if integrates:  # Simpson's rule
                middle = w_B[np.searchsorted(grid, middles.round(9))]
                times, value = times[1:], (value[:-1] + 4 * middle + value[1:]) / 6
            matrix = ARCSEC * sensor.misalignment_arcsec * fixed.standard_normal((3, 3))
            np.fill_diagonal(matrix, 1e-6 * sensor.scale_ppm * fixed.standard_normal(3))
            walk = rng.standard_normal(value.shape) * sensor.bias_random_walk / 60
            walk /= np.sqrt(sensor.rate)
            walk[0] = sensor.bias * rng.standard_normal(3)
            white = 60 * ARCSEC * sensor.angle_random_walk * np.sqrt(sensor.rate)
            value = value + value @ matrix.T + DEGREE_HOUR * np.cumsum(walk, axis=0)
            value = value + noise * white * rng.standard_normal(value.shape)
        elif name == "position":
            arm = 1e-3 * sensor.lever_arm_mm * fixed.standard_normal(3)
            columns, value = ("x", "y", "z"), motion["p"][at] + motion["R"][at].apply(arm)
            value = value + noise * sensor.sigma * rng.standard_normal(value.shape)
        else:
            columns, value = tuple(f"q:{n}" for n in world.craft.joint_names), motion["q"][at]
            value = value + 1e-3 * sensor.zero_mrad * fixed.standard_normal(value.shape[1])
            value = value + noise * sensor.sigma * rng.standard_normal(value.shape)
            if sensor.bits:
                step = 2 * np.pi / 2**sensor.bits
                offset = rng.uniform(-0.5, 0.5, value.shape[1])
                value = step * (np.round(value / step - offset) + offset)
        lost = np.zeros(len(times), dtype=bool)  # dropouts begin and end at random
        for k in np.flatnonzero(rng.random(len(times)) < sensor.dropouts / 60 / sensor.rate):
            length = rng.exponential(sensor.dropout_length) * sensor.rate
            lost[k : k + max(1, round(length))] = True
        series |= {c: (times[~lost] + delay, v[~lost]) for c, v in zip(columns, value.T)}
    if world.thrust and world.scenario.simulation.burns_logged:
        edges = np.unique([t for start, end, _ in world.thrust for t in (start, end)])
        logged = [sum((w for a, b, w in world.thrust if a <= t < b), np.zeros(6)) for t in edges]
        series |= {c: (edges, v / (1 + scale)) for c, v in zip(THRUST, np.array(logged).T)}
    save(path, series)
    return path


def _wrench(burn) -> Array:
    return np.append(burn.torque_B + np.cross(burn.p_BF_B, burn.force_B), burn.force_B)


def save(path: Path, series: dict[str, tuple[Array, Array]]) -> None:
    """Write series of times and values as columns of one table, with NaN where there is none."""
    columns = {"time": np.unique(np.concatenate([time for time, _ in series.values()]))}
    for name, (time, values) in series.items():
        columns[name] = np.full(len(columns["time"]), np.nan)
        columns[name][np.searchsorted(columns["time"], time)] = values
    write_columns(path, columns)


def write_columns(path: Path, columns: dict[str, Array]) -> None:
    """Write columns to a Parquet file."""
    parquet.write_table(pyarrow.table(columns), path)


def _stated(errors):
    """Return errors of which those that are not stated are zero."""
    result = copy(errors)
    for name, value in ({} if errors is None else vars(errors)).items():
        if value is None and name != "orbit":
            setattr(result, name, 0.0)
    return result


def _draw_forces(world: World, suite: SensorSuite, rng: np.random.Generator) -> float:
    """Draw the disturbance of a world; return the error of the scale of logged thrust."""
    size, given = _stated(suite.disturbances), world.scenario.simulation.disturbance
    pieces, scale = np.zeros((int(np.ceil(world.duration / WALK)), 6)), 0.0
    if size is not None:
        constant = np.repeat([size.torque, size.acceleration], 3) * rng.standard_normal(6)
        walk = np.repeat([size.torque_walk, size.acceleration_walk], 3) * np.sqrt(WALK)
        pieces[1:] = np.cumsum(walk * rng.standard_normal(pieces[1:].shape), axis=0)
        pieces += constant
        scale = float(size.thrust_scale * rng.standard_normal())
        if size.orbit is not None:
            o = size.orbit
            rate = o.rate or np.sqrt(EARTH / (EARTH_RADIUS + 1e3 * o.altitude_km) ** 3)
            world.orbit = float(rate), np.asarray(o.nadir_W), np.asarray(o.normal_W)
    for place, value in ((slice(0, 3), given.torque_W), (slice(3, 6), given.acceleration_W)):
        if value is not None:
            pieces[:, place] = value
    world.disturbance = pieces if pieces.any() else None
    return scale
