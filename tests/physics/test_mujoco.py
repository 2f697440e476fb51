"""An independent simulator: what MuJoCo simulates, logged as a CSV file, is identified right.

Nothing on the truth's way is ours: MuJoCo reads the model, is given the target, and integrates. The
joints follow a smooth reference by springs and dampers. These are internal torques: the total
momentum stays zero from rest, whatever the joints really do.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from planar_cases import KNOWN, planar_craft
from planar_cases import TARGET as ON_TABLE

from cpid_drake import InertialParameters, Motion, Spacecraft, identify
from cpid_drake.dynamics.total_momentum import TotalMomentum
from cpid_drake.files.resources import resolve_model

mujoco = pytest.importorskip("mujoco", reason="needs the package mujoco")

STEP, LOG_PERIOD, DURATION = 1e-3, 1e-2, 10.0  # [s]
STIFFNESS, DAMPING = 25.0, 10.0  # over inertia [1/s², 1/s]

TOLERANCE = 1e-6
"""Of m, of 0.5 m, of I's trace. Measured at steps of 2, 1 and 0.5 ms, standard rows: 3.4e-11,
2.1e-12 and 2.2e-13 for the arm below, 1.0e-10, 6.2e-12 and 3.9e-13 for the servicer. They fall by
16 as RK4's errors do: what is left is MuJoCo's integration, not another physics."""

# Frames, centres of mass and axes point anywhere; wrists roll, arms bend in all planes.
ARM = """
<body name="{side}_shoulder" pos="0.7 {y} 0.1" euler="0 80 {yaw}">
  <inertial pos="0.02 0 0.12" mass="9" diaginertia="0.08 0.07 0.05"/>
  <joint name="{side}_1" axis="0 0 1"/>
  <body name="{side}_upper" pos="0 0.05 0.25" euler="20 0 0">
    <inertial pos="0 0.03 0.45" euler="10 20 30" mass="14" diaginertia="1.1 1.0 0.1"/>
    <joint name="{side}_2" axis="0 1 0"/>
    <body name="{side}_fore" pos="0 0 0.9" euler="0 -60 0">
      <inertial pos="0.02 0 0.4" mass="8" fullinertia="0.6 0.55 0.06 0.01 -0.02 0.03"/>
      <joint name="{side}_3" axis="0.1 1 0.2" pos="0 0.02 0"/>
      <body name="{side}_wrist" pos="0 0 0.8" euler="0 40 0">
        <inertial pos="0 0 0.05" mass="4" diaginertia="0.02 0.02 0.01"/>
        <joint name="{side}_4" axis="0 0 1"/>
        <body name="{side}_hand" pos="0 0 0.12" euler="0 0 30">
          <inertial pos="0 0.01 0.05" mass="3" diaginertia="0.012 0.011 0.008"/>
          <joint name="{side}_5" axis="0 1 0"/>
          <body name="{side}_grip" pos="0 0 0.2" euler="30 -50 10"/>
        </body>
      </body>
    </body>
  </body>
</body>
"""
DUAL_ARM = f"""
<mujoco model="dual_arm">
  <worldbody>
    <body name="bus" pos="0 0 0">
      <freejoint name="free"/>
      <inertial pos="0.05 -0.03 0.1" euler="5 10 15" mass="600" diaginertia="150 130 170"/>
      {ARM.format(side="left", y=0.5, yaw=20)}
      {ARM.format(side="right", y=-0.5, yaw=-30)}
    </body>
  </worldbody>
</mujoco>
"""
SERVICER = "package://cpid_drake_models/dual_arm_servicer/dual_arm_servicer.urdf"


@dataclass
class Log:
    """What MuJoCo logged, by CSV column."""

    columns: list[str]
    rows: NDArray[np.float64]

    def write(self, file: Path) -> Path:
        np.savetxt(file, self.rows, "%.17g", ",", header=",".join(self.columns), comments="")
        return file

    def telemetry(self, joint_names: tuple[str, ...]) -> Motion:
        base = np.split(self.rows[:, 1:14], [4, 7, 10], axis=1)
        q, qdot = ([self.columns.index(f"{k}:{name}") for name in joint_names] for k in ("q", "qd"))
        return Motion(joint_names, self.rows[:, 0], *base, self.rows[:, q], self.rows[:, qdot])


def simulate(
    model_file: Path,
    capture_body: str,
    target: InertialParameters,
    *,
    step: float = STEP,
    start_twist: tuple[float, ...] = (0.0,) * 6,
    base: str = "bus",
    on_table: bool = False,
) -> Log:
    """Simulate the model in MuJoCo with the target on one of its bodies.

    `start_twist` is (v_WBo_W, w_WB_B), MuJoCo's convention for a free joint. On a table, two slides
    and a hinge hold the base against its weight, in place of a free joint.
    """
    spec = mujoco.MjSpec.from_file(str(model_file))
    spec.compiler.fusestatic = False  # bodies without a joint are to stay, in URDF too
    body, kinds = spec.body(base), mujoco.mjtJoint
    if on_table:
        body.add_joint(name="x", type=kinds.mjJNT_SLIDE, axis=[1, 0, 0])
        body.add_joint(name="y", type=kinds.mjJNT_SLIDE, axis=[0, 1, 0])
        body.add_joint(name="yaw", type=kinds.mjJNT_HINGE, axis=[0, 0, 1])
    elif not body.joints:  # URDF knows no free joint
        body.add_freejoint()
    held = spec.body(capture_body).add_body(name="target")
    held.mass, held.ipos, held.explicitinertial = target.mass, target.p_CTcm_C, True
    held.fullinertia = target.to_vector()[4:]  # xx, yy, zz, xy, xz, yz here and there
    option, disable = spec.option, mujoco.mjtDisableBit
    option.integrator, option.timestep = mujoco.mjtIntegrator.mjINT_RK4, step
    option.gravity = np.array([0.0, 0.0, -9.81 * on_table])
    option.density, option.viscosity = 0.0, 0.0
    option.disableflags |= disable.mjDSBL_CONTACT | disable.mjDSBL_LIMIT
    model = spec.compile()
    data = mujoco.MjData(model)
    n, m = (3, 3) if on_table else (6, 7)  # of the base: velocities, positions
    data.qvel[:n] = start_twist[:n]

    names = [model.joint(k).name for k in range(3 if on_table else 1, model.njnt)]
    j = np.arange(len(names))
    swing, frequency = 0.6 + 0.2 * np.sin(j), 0.6 + 0.4 * np.cos(2 * j)  # [rad], [rad/s]
    rows, log_every = [], round(LOG_PERIOD / step)
    for k in range(round(DURATION / step) + 1):
        if k % log_every == 0:
            mujoco.mj_forward(model, data)
            rows.append([data.time, *data.qpos, *data.qvel] if on_table else _log_row(data))
            inertia = _joint_inertia(model, data, n)
        phase = frequency * data.time
        error = swing * (1 - np.cos(phase)) - data.qpos[m:]
        rate_error = swing * frequency * np.sin(phase) - data.qvel[n:]
        data.qfrc_applied[n:] = inertia @ (STIFFNESS * error + DAMPING * rate_error)
        mujoco.mj_step(model, data)
    columns = ["time", "qw", "qx", "qy", "qz", "x", "y", "z", "wx", "wy", "wz", "vx", "vy", "vz"]
    q, qdot = ([f"{kind}:{name}" for name in names] for kind in ("q", "qd"))
    if on_table:
        return Log(["time", "x", "y", "yaw", *q, "vx", "vy", "wz", *qdot], np.array(rows))
    return Log([*columns, *q, *qdot], np.array(rows))


def _log_row(data: "mujoco.MjData") -> list[float]:
    w_WB_W = data.body("bus").xmat.reshape(3, 3) @ data.qvel[3:6]  # MuJoCo has w_WB_B
    base = [*data.qpos[3:7], *data.qpos[:3], *w_WB_W, *data.qvel[:3]]
    return [data.time, *base, *data.qpos[7:], *data.qvel[6:]]


def _joint_inertia(model: "mujoco.MjModel", data: "mujoco.MjData", n: int) -> NDArray[np.float64]:
    """Return the joints' mass matrix with the base free to move."""
    M = np.empty((model.nv, model.nv))
    for row, unit in zip(M, np.eye(model.nv)):
        mujoco.mj_mulM(model, data, row, unit)
    return M[n:, n:] - M[n:, :n] @ np.linalg.solve(M[:n, :n], M[:n, n:])


def assert_identified(parameters, target: InertialParameters) -> None:
    """Every one of the ten within 1e-6 of its scale."""
    truth = target.to_vector()
    scale = np.array([target.mass] + 3 * [0.5] + 6 * [np.trace(target.I_TTcm_C)])
    np.testing.assert_array_less(np.abs(parameters - truth) / scale, TOLERANCE)


@pytest.fixture(scope="module")
def dual_arm_file(tmp_path_factory) -> Path:
    file = tmp_path_factory.mktemp("mujoco") / "dual_arm.xml"
    file.write_text(DUAL_ARM)
    return file


@pytest.fixture(scope="module")
def dual_arm(dual_arm_file) -> Spacecraft:
    return Spacecraft(dual_arm_file, base="bus", capture_frame="left_grip")


@pytest.fixture(scope="module")
def dual_arm_log(dual_arm_file, skewed_target) -> Log:
    return simulate(dual_arm_file, "left_grip", skewed_target)


@pytest.mark.parametrize("rows", ["eq18", "standard", "relative"])
def test_what_mujoco_simulates_is_identified(dual_arm, dual_arm_log, skewed_target, rows):
    telemetry = dual_arm_log.telemetry(dual_arm.joint_names)
    assert_identified(identify(dual_arm, telemetry, rows=rows).parameters, skewed_target)


def test_the_shipped_servicer_moves_in_mujoco_as_here(servicer, paper_target):
    log = simulate(resolve_model(SERVICER), "capture_point", paper_target)
    telemetry = log.telemetry(servicer.joint_names)
    assert_identified(identify(servicer, telemetry, rows="standard").parameters, paper_target)


def test_a_tumbling_capture_in_mujoco_is_identified(dual_arm, dual_arm_file, skewed_target):
    start = (0.02, -0.01, 0.03, 0.03, -0.02, 0.04)
    log = simulate(dual_arm_file, "left_grip", skewed_target, start_twist=start)
    telemetry = log.telemetry(dual_arm.joint_names)
    for rows in ("standard", "relative"):
        result = identify(dual_arm, telemetry, rows=rows, momentum=TotalMomentum.unknown())
        assert_identified(result.parameters, skewed_target)
        taken_as_zero = identify(dual_arm, telemetry, rows=rows, momentum=TotalMomentum.zero())
        assert "contradict a total momentum of zero" in taken_as_zero.failures[0]
        assert_identified(taken_as_zero.parameters, skewed_target)


@pytest.fixture(scope="module")
def on_table(tmp_path_factory):
    """The file of a log on a table, and that of the model; a free base would tilt."""
    craft = planar_craft(tmp_path_factory.mktemp("planar_mujoco"))
    log = simulate(craft.path, "grip", ON_TABLE, base="base", on_table=True)
    assert np.abs(log.rows[:, 1:4]).max() > 0.05  # the base moves
    return log.write(craft.path.with_name("log.csv")), craft.path


def test_the_four_of_mujocos_planar_joint_are_identified(on_table, tmp_path, run_cpid):
    path, model = on_table
    result = tmp_path / "result.json"
    craft = ["--model", model, "--base", "base", "--capture-frame", "grip"]
    code, text, _ = run_cpid("identify", path, *craft, "--json", result)
    assert code == 0
    assert "are identifiable; the others have no effect" in text
    assert "three axes" not in text
    found = json.loads(result.read_text())
    values = np.array(found["parameters"], dtype=float)
    np.testing.assert_allclose(values[KNOWN], ON_TABLE.to_vector()[KNOWN], rtol=1e-6)
    assert np.isnan(np.delete(values, KNOWN)).all()
    low, high = np.array(found["consistent_intervals"], float).T
    assert (low <= ON_TABLE.to_vector() + 1e-6).all()
    assert (ON_TABLE.to_vector() <= high + 1e-6).all()


def test_a_free_base_does_not_explain_the_log(on_table, run_cpid):
    """Both halves of the log are wrong alike, and what is open must not explain the errors."""
    path, model = on_table
    craft = ["--model", model, "--base", "base", "--capture-frame", "grip"]
    code, text, _ = run_cpid("identify", path, *craft, "--no-planar", "--rows", "standard")
    assert code == 4
    assert "failed check" in text
