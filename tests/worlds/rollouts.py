"""One noisy log, three ways to identify: `python tests/worlds/rollouts.py [--write]`.

MuJoCo simulates a free-flyer whose joints have position servos; no code is shared with the package.
The three ways get the same samples, and the exact model of the spacecraft:

- `identify` of this package: momentum, all sensors, noise of the sensors as stated;
- rollouts in MuJoCo, as its toolbox `mujoco.sysid` does: commands, servos and the target are
  simulated, and the residuals of all sensors are minimized over the target. It needs a model of the
  servos;
- SciPy's `least_squares`, as a script of thirty lines: splines through the encoders, the base's
  attitude and position from the conservation of momentum.

The last two have the usual interval, s² (JᵀJ)⁻¹ of the residuals. `--write` puts the table into
docs/explanation/comparison.md.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # as pytest does
from scipy.interpolate import make_lsq_spline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from worlds.hidden_world import CRAFTS, RAMP, SENSORS, Array

from cpid_drake import InertialParameters, Log, Spacecraft, identify
from cpid_drake.dynamics.parameterizations import STANDARD
from cpid_drake.logs.log import Samples

PAGE = Path(__file__).parents[2] / "docs/explanation/comparison.md"
CRAFT = CRAFTS["free_flyer"]
STEP, DURATION, RATE = 2e-3, 10.0, 50  # [s], [s], [Hz]
STIFFNESS = np.array([2.0, 6.0, 6.0, 3.0, 2.0])  # of the servos [N·m/rad]
DAMPING = 0.15 * STIFFNESS  # [N·m·s/rad]
OFF = 0.02


def truth_of(craft=CRAFT) -> InertialParameters:
    """Return the target."""
    mass, radii, com = craft.target
    return InertialParameters(mass, np.array(com), mass * np.diag(np.square(radii)))


def commands(t: float) -> Array:
    """Return the positions that the servos are to have [rad]; they rise smoothly from rest."""
    k, rise = np.arange(5), min(t / RAMP, 1.0)
    rise = rise**3 * (10 - 15 * rise + 6 * rise**2)
    return np.array(CRAFT.centre) + rise * (
        0.35 * np.sin(2 * np.pi * (0.13 + 0.05 * k) * t + k)
        + 0.2 * np.sin(2 * np.pi * (0.31 - 0.04 * k) * t + 2 * k)
    )


class World:
    """MuJoCo's model of the craft with a target and servos."""

    def __init__(self, gain: float = 1.0) -> None:
        spec = mujoco.MjSpec.from_string(CRAFT.mjcf())
        held = spec.body("grip").add_body(name="target")
        held.mass, held.inertia, held.explicitinertial = 1.0, np.ones(3), True
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        spec.option.timestep, spec.option.gravity = STEP, np.zeros(3)
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.model, self.gain = spec.compile(), gain
        self.data = mujoco.MjData(self.model)
        self.target = self.model.body("target").id

    def run(self, target: InertialParameters) -> dict[str, Array]:
        """Return the exact samples of all sensors at `RATE` from rest."""
        model, data = self.model, self.data
        moments, axes = np.linalg.eigh(target.I_TTcm_C)
        axes *= np.sign(np.linalg.det(axes))
        model.body_mass[self.target], model.body_ipos[self.target] = target.mass, target.p_CTcm_C
        model.body_inertia[self.target] = moments
        quaternion = Rotation.from_matrix(axes).as_quat(scalar_first=True)
        model.body_iquat[self.target] = quaternion
        mujoco.mj_setConst(model, data)
        mujoco.mj_resetData(model, data)
        data.qpos[7:], every, rows = commands(0.0), round(1 / RATE / STEP), []
        for number in range(round(DURATION / STEP) + 1):
            if number % every == 0:
                rows.append(np.hstack([data.qpos.copy(), data.qvel.copy()]))
            aim = commands(data.time)
            torque = STIFFNESS * (aim - data.qpos[7:]) - DAMPING * data.qvel[6:]
            data.qfrc_applied[6:] = self.gain * torque
            mujoco.mj_step(model, data)
        table = np.array(rows)
        return {
            "attitude": table[:, 3:7],
            "gyro": table[:, 15:18],
            "position": table[:, :3],
            "encoders": table[:, 7:12],
        }


def noisy(exact: dict[str, Array], seed: int) -> dict[str, Array]:
    """Return samples with white noise."""
    rng, (cross, _, gyro, position, encoders) = np.random.default_rng(seed), CRAFT.sigmas
    turned = Rotation.from_quat(exact["attitude"], scalar_first=True) * Rotation.from_rotvec(
        cross * rng.standard_normal((len(exact["gyro"]), 3))
    )
    found = {"attitude": turned.as_quat(scalar_first=True)}
    for name, sigma in (("gyro", gyro), ("position", position), ("encoders", encoders)):
        found[name] = exact[name] + sigma * rng.standard_normal(exact[name].shape)
    return found


def residuals(predicted: dict[str, Array], measured: dict[str, Array], names=SENSORS) -> Array:
    """Return the residuals of sensors in σ."""
    cross, _, gyro, position, encoders = CRAFT.sigmas
    sigmas = {"gyro": gyro, "position": position, "encoders": encoders}
    rest = {name: (predicted[name] - measured[name]) / sigmas[name] for name in sigmas}
    turns = [
        Rotation.from_quat(each["attitude"], scalar_first=True) for each in (measured, predicted)
    ]
    rest["attitude"] = (turns[0].inv() * turns[1]).as_rotvec() / cross
    return np.concatenate([rest[name].ravel() for name in names])


@dataclass
class Answer:
    """Parameters, their σ, whether the method itself says that something is wrong, and the time."""

    parameters: Array
    sigma: Array
    says: str
    seconds: float

    @property
    def worst(self) -> float:
        """The largest error in σ."""
        return float((np.abs(self.parameters - truth_of().to_vector()) / self.sigma).max())


def minimized(fun: Callable[[InertialParameters], Array]) -> tuple[Array, Array, float]:
    """Return parameters, σ of s² (JᵀJ)⁻¹, and s, the residual in σ, from a bad first guess."""
    guess = InertialParameters(5.0, [0.1, 0.0, 0.0], 0.1 * np.eye(3))
    unit = np.array([1, 0.5, 0.5, 0.5, *6 * [0.2]])

    def of(x: Array) -> Array:
        target = InertialParameters.from_vector(STANDARD.to_parameters(x * unit))
        if target.mass <= 0 or np.linalg.eigvalsh(target.I_TTcm_C)[0] <= 0:
            return np.full(size, 1e4)
        return fun(target)

    start = STANDARD.from_parameters(guess.to_vector()) / unit
    size = len(fun(guess))
    found = least_squares(of, start, x_scale="jac", max_nfev=40)
    s = np.sqrt(np.sum(found.fun**2) / (found.fun.size - 10))
    covariance = s**2 * np.linalg.inv(found.jac.T @ found.jac)
    step, phi = 1e-6, found.x * unit
    jacobian = (
        np.column_stack(
            [
                (STANDARD.to_parameters(phi + step * e) - STANDARD.to_parameters(phi - step * e))
                / (2 * step)
                for e in np.eye(10)
            ]
        )
        * unit
    )
    return STANDARD.to_parameters(phi), np.sqrt(np.diag(jacobian @ covariance @ jacobian.T)), s


def by_mujoco(measured: dict[str, Array]) -> Answer:
    """Return the fit of rollouts with the nominal servos."""
    begin, world = time.perf_counter(), World()
    found, sigma, s = minimized(lambda target: residuals(world.run(target), measured))
    return Answer(found, sigma, f"residuals of {s:.2f} σ", time.perf_counter() - begin)


class Splines:
    """Joint motion: splines of degree 5 through the encoders, three pieces in a second."""

    def __init__(self, times: Array, positions: Array) -> None:
        inner = np.linspace(times[0], times[-1], 31)
        knots = np.concatenate([5 * [times[0]], inner, 5 * [times[-1]]])
        self.duration = float(times[-1])
        self._splines = [make_lsq_spline(times, positions, knots, 5)]
        self._splines += [self._splines[0].derivative(k) for k in (1, 2)]

    def evaluate(self, time: Array) -> Array:
        """Return positions, rates and accelerations (..., 3, J)."""
        return np.stack([spline(np.asarray(time)) for spline in self._splines], axis=-2)

    def instants(self) -> Array:
        """Return instants between which the motion is smooth."""
        return self.breaks()

    def breaks(self) -> Array:
        """Return the knots."""
        return np.unique(self._splines[0].t)


def by_scipy(measured: dict[str, Array], spacecraft: Spacecraft) -> Answer:
    """Return the fit of the base's motion from splines through the encoders."""
    begin, times = time.perf_counter(), np.arange(len(measured["gyro"])) / RATE
    motion = Splines(times, measured["encoders"])

    def rest(target: InertialParameters) -> Array:
        base = spacecraft.predicted_motion(target, motion, times)
        predicted = {
            "attitude": base.quaternion_WB,
            "gyro": np.einsum("nji,nj->ni", base.R_WB, base.w_WB),
            "position": base.p_WB,
            "encoders": measured["encoders"],
        }
        return residuals(predicted, measured, ("attitude", "gyro", "position"))

    found, sigma, s = minimized(rest)
    return Answer(found, sigma, f"residuals of {s:.2f} σ", time.perf_counter() - begin)


def by_package(measured: dict[str, Array], spacecraft: Spacecraft, *, exact: bool) -> Answer:
    """Return the answer of `identify`, of exact hardware or of hardware with plausible errors."""
    begin, times = time.perf_counter(), np.arange(len(measured["gyro"])) / RATE
    samples = {name: Samples(times, measured[name]) for name in SENSORS}
    suite = CRAFT.suite().exact() if exact else CRAFT.suite()
    found = identify(spacecraft, Log(spacecraft.joint_names, samples), sensors=suite)
    says = found.failures[0] if found.failures else "all checks passed"
    sigma = np.sqrt(np.diag(found.covariance))
    return Answer(found.parameters, sigma, says, time.perf_counter() - begin)


ROWS = ("identify, exact hardware", "identify, plausible errors", "MuJoCo rollouts", "SciPy")


def compared(gain: float, seed: int, rows=ROWS) -> dict[str, Answer]:
    """Return the answers about a log of a world whose servos have this gain."""
    measured = noisy(World(gain).run(truth_of()), seed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "craft.xml"
        file.write_text(CRAFT.mjcf())
        spacecraft = Spacecraft(file, base="base", capture_frame="grip")
        ways = {
            ROWS[0]: lambda: by_package(measured, spacecraft, exact=True),
            ROWS[1]: lambda: by_package(measured, spacecraft, exact=False),
            ROWS[2]: lambda: by_mujoco(measured),
            ROWS[3]: lambda: by_scipy(measured, spacecraft),
        }
        return {name: ways[name]() for name in rows}


def table(seed: int) -> str:
    """Return the table of the page."""
    lines = [
        "| Servos | Way | mass [kg] | worst error | what it says |",
        "|---|---|---|---|---|",
    ]
    for gain, servos in ((1.0, "as modelled"), (1 + OFF, f"{OFF:.0%} stronger")):
        for name, answer in compared(gain, seed).items():
            mass = f"{answer.parameters[0]:.4f} ± {answer.sigma[0]:.4f}"
            lines.append(f"| {servos} | {name} | {mass} | {answer.worst:.1f} σ | {answer.says} |")
            print(lines[-1], f"{answer.seconds:.0f} s", flush=True)
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", action="store_true", help="put the table into the page")
    args = parser.parse_args()
    text = table(args.seed)
    if args.write:
        before, _, rest = PAGE.read_text(encoding="utf-8").partition("| Servos |")
        after = rest.partition("\n\n")[2]
        PAGE.write_text(f"{before}{text}\n\n{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
