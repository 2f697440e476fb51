"""An independent simulator of a table: MuJoCo with a planar joint, logged as x, y and yaw.

The joint of the base is two slides and a hinge. Its constraint forces are those of a table; the
target is high above the plane and has products of inertia, so a free base would tilt.
"""

import csv
import json

import numpy as np
import pytest
from planar_cases import KNOWN, TARGET, planar_craft

mujoco = pytest.importorskip("mujoco", reason="needs the package mujoco")

STEP, LOG_PERIOD, DURATION = 1e-3, 2e-2, 10.0  # [s]


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("planar_mujoco")
    craft = planar_craft(folder)
    spec = mujoco.MjSpec.from_file(str(craft.path))
    spec.compiler.fusestatic = False
    base = spec.body("base")
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for name, kind, axis in (
        ("x", slide, [1, 0, 0]),
        ("y", slide, [0, 1, 0]),
        ("yaw", hinge, [0, 0, 1]),
    ):
        base.add_joint(name=name, type=kind, axis=axis)
    held = spec.body("grip").add_body(name="target")
    held.mass, held.ipos, held.explicitinertial = TARGET.mass, TARGET.p_CTcm_C, True
    held.fullinertia = TARGET.to_vector()[4:]
    option, disable = spec.option, mujoco.mjtDisableBit
    option.integrator, option.timestep = mujoco.mjtIntegrator.mjINT_RK4, STEP
    option.gravity = np.array([0.0, 0.0, -9.81])  # the table carries the weight
    option.disableflags |= disable.mjDSBL_CONTACT | disable.mjDSBL_LIMIT
    model = spec.compile()
    data = mujoco.MjData(model)
    names = [model.joint(k).name for k in range(3, model.njnt)]
    j = np.arange(len(names))
    swing, frequency = 0.7 + 0.2 * np.sin(j), 0.7 + 0.4 * np.cos(2 * j)
    path = folder / "log.csv"
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(
            ["time", "x", "y", "yaw", "vx", "vy", "wz", *(f"q:{n}" for n in names)]
            + [f"qd:{n}" for n in names]
        )
        for k in range(round(DURATION / STEP) + 1):
            if k % round(LOG_PERIOD / STEP) == 0:
                q, v = data.qpos, data.qvel
                writer.writerow(
                    [repr(float(e)) for e in (data.time, *q[:3], *v[:3], *q[3:], *v[3:])]
                )
            phase = frequency * data.time
            error = swing * (1 - np.cos(phase)) - data.qpos[3:]
            rate_error = swing * frequency * np.sin(phase) - data.qvel[3:]
            data.qfrc_applied[3:] = 2.0 * error + 0.4 * rate_error
            mujoco.mj_step(model, data)
    assert np.abs(data.qpos[:3]).max() > 0.05  # the base moves
    return path, craft.path


def test_the_four_of_mujocos_planar_joint_are_identified(log, tmp_path, run_cpid):
    path, model = log
    result = tmp_path / "result.json"
    craft = ["--model", model, "--base", "base", "--capture-frame", "grip"]
    code, text, _ = run_cpid("identify", path, *craft, "--json", result)
    assert code == 0
    assert "are identifiable; the others have no effect" in text
    assert "three axes" not in text
    found = json.loads(result.read_text())
    values = np.array(found["parameters"], dtype=float)
    np.testing.assert_allclose(values[KNOWN], TARGET.to_vector()[KNOWN], rtol=1e-6)
    assert np.isnan(np.delete(values, KNOWN)).all()
    low, high = np.array(found["consistent_intervals"], float).T
    assert (low <= TARGET.to_vector() + 1e-6).all()
    assert (TARGET.to_vector() <= high + 1e-6).all()


def test_a_free_base_does_not_explain_the_log(log, run_cpid):
    """Both halves of the log are wrong alike, and what is open must not explain the errors."""
    path, model = log
    craft = ["--model", model, "--base", "base", "--capture-frame", "grip"]
    code, text, _ = run_cpid("identify", path, *craft, "--no-planar", "--rows", "standard")
    assert code == 4
    assert "failed check" in text
