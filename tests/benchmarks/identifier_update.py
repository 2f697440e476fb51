#!/usr/bin/env python3
"""Time one identifier update and one solve against the same work on Pinocchio.

Both routes take the same states of the same spacecraft, form the standard rows (for Eq. 18 rows the
work here is the same) and end in the same estimate, which is checked before anything is timed:

- here: Drake kinematics, momentum about the capture point, rows, square-root information filter;
- reference: Pinocchio forward kinematics, its body regressor as momentum rows of the target, its
  centroidal momentum of the known bodies, NumPy QR of the stacked triangle; NumPy's solution,
  covariance and condition numbers.

Times are medians over interleaved blocks, so that both routes see the same machine.
"""

import argparse
import json
import statistics
import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from cpid_drake import HalfCosine, InertialParameters, MomentumIdentifier, Motion, Spacecraft
from cpid_drake.dynamics.body_dynamics import BodyDynamics
from cpid_drake.dynamics.parameterizations import STANDARD, standard_to_relative
from cpid_drake.estimation.gaussian import solution_of_rows
from cpid_drake.estimation.least_squares import empty_information, updated_information
from cpid_drake.resources import resolve_model

MODEL = "package://cpid_drake_models/dual_arm_servicer/dual_arm_servicer.urdf"


class PinocchioRoute:
    """The same update, written on Pinocchio and NumPy."""

    # Pinocchio's order of a body's parameters: m, h, Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
    TO_STANDARD = np.array([0, 1, 2, 3, 4, 5, 7, 6, 8, 9])

    def __init__(self, spacecraft: Spacecraft) -> None:
        path = str(resolve_model(MODEL))
        self.model = pin.buildModelFromUrdf(path, pin.JointModelFreeFlyer())
        self.data = self.model.createData()
        self.frame = self.model.getFrameId("capture_point")
        self.columns = [spacecraft.joint_names.index(name) for name in list(self.model.names)[2:]]
        self.rest = pin.Motion.Zero()

    def state(self, telemetry: Motion, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Return Pinocchio's q and v: quaternion (x, y, z, w), base twist in the base frame."""
        w, x, y, z = telemetry.quaternion_WB[k]
        R_BW = telemetry.R_WB[k].T
        joints = telemetry.q[k][self.columns], telemetry.qdot[k][self.columns]
        q = np.concatenate([telemetry.p_WB[k], [x, y, z, w], joints[0]])
        twist = [R_BW @ telemetry.v_WB[k], R_BW @ telemetry.w_WB[k]]
        return q, np.concatenate([*twist, joints[1]])

    def update(self, root: np.ndarray, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the triangle after one sample."""
        model, data = self.model, self.data
        pin.forwardKinematics(model, data, q, v)
        X_WC = pin.updateFramePlacement(model, data, self.frame)
        V_C = pin.getFrameVelocity(model, data, self.frame, pin.LOCAL)
        h = pin.computeCentroidalMomentum(model, data)
        P = X_WC.rotation.T @ h.linear
        L = X_WC.rotation.T @ (h.angular + np.cross(data.com[0] - X_WC.translation, h.linear))
        rows = np.empty((6, 11))
        rows[:, :10] = pin.bodyRegressor(self.rest, V_C)
        rows[:3, 10], rows[3:, 10] = -P, -L
        return np.linalg.qr(np.vstack([root, rows]), mode="r")

    @staticmethod
    def solve(root: np.ndarray, rows: int) -> tuple[np.ndarray, ...]:
        """Return estimate (in Pinocchio's order), covariance, and both condition numbers."""
        R, z = root[:10, :10], root[:10, 10]
        scale = np.linalg.norm(R, axis=0)
        scaled, _, rank, s = np.linalg.lstsq(R / scale, z, rcond=1e-9)
        variance = root[10, 10] ** 2 / (rows - rank)
        covariance = variance * np.linalg.inv(R.T @ R)
        return scaled / scale, covariance, s[0] / s[-1], np.linalg.cond(R)


def medians(functions: dict[str, Callable], blocks: int, calls: int) -> dict[str, float]:
    """Return the median time of one call of each function [µs]."""
    times: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(blocks):
        for name, function in functions.items():
            start = time.perf_counter()
            for _ in range(calls):
                function()
            times[name].append((time.perf_counter() - start) / calls * 1e6)
    return {name: statistics.median(values) for name, values in times.items()}


def zero_momentum_telemetry(spacecraft: Spacecraft, target: InertialParameters) -> Motion:
    """Return twenty samples of a motion of all joints at zero total momentum."""
    rng = np.random.default_rng(1)
    joints = len(spacecraft.joint_names)
    motion = HalfCosine(rng.uniform(-1, 1, joints), rng.uniform(-1, 1, joints), duration=10.0)
    times = np.linspace(0.5, 9.5, 20)
    q, qdot, _ = np.moveaxis(motion.evaluate(times), 1, 0)
    psi = standard_to_relative(target.to_standard_vector(), spacecraft.mass)
    w_WB, v_WB = BodyDynamics.at(spacecraft.tree, q, qdot).base_twist(psi)
    attitude = np.tile([1.0, 0.0, 0.0, 0.0], (20, 1))
    names = spacecraft.joint_names
    return Motion(names, times, attitude, np.zeros((20, 3)), w_WB, v_WB, q, qdot)


def main() -> None:
    """Check that both routes agree, time them and print the result as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--blocks", type=int, default=41)
    parser.add_argument("--calls", type=int, default=500)
    args = parser.parse_args()

    spacecraft = Spacecraft(MODEL, base="bus", capture_frame="capture_point")
    target = InertialParameters(100.0, [0.4330127, 0.0, 0.0], np.diag([20.0, 30.0, 10.0]))
    telemetry = zero_momentum_telemetry(spacecraft, target)
    states = spacecraft.to_states(telemetry)

    identifier = MomentumIdentifier(spacecraft, rows="standard")
    eq18 = MomentumIdentifier(spacecraft, rows="eq18")
    reference = PinocchioRoute(spacecraft)
    ours, ours_eq18, theirs = empty_information(), empty_information(), empty_information()
    for k, state in enumerate(states):
        ours = updated_information(ours, identifier.rows(state))
        ours_eq18 = updated_information(ours_eq18, eq18.rows(state))
        theirs = reference.update(theirs, *reference.state(telemetry, k))
    rows = 6 * len(states)
    estimate = STANDARD.to_parameters(solution_of_rows(ours, rows).estimate)
    check = STANDARD.to_parameters(reference.solve(theirs, rows)[0][reference.TO_STANDARD])
    np.testing.assert_allclose(estimate, check, rtol=0, atol=1e-8)
    np.testing.assert_allclose(estimate, target.to_vector(), rtol=0, atol=1e-8)

    state, (q, v) = states[7], reference.state(telemetry, 7)
    context = identifier.CreateDefaultContext()
    identifier.GetInputPort("state").FixValue(context, state)

    def event() -> None:
        context.SetTime(context.get_time() + 1.0)  # else Drake answers from its cache
        identifier.EvalUniquePeriodicDiscreteUpdate(context)

    times = medians(
        {
            "update": lambda: updated_information(ours, identifier.rows(state)),
            "update_eq18": lambda: updated_information(ours_eq18, eq18.rows(state)),
            "update_pinocchio": lambda: reference.update(theirs, q, v),
            "update_as_event": event,
            "solve": lambda: solution_of_rows(ours, rows),
            "solve_pinocchio": lambda: reference.solve(theirs, rows),
        },
        args.blocks,
        args.calls,
    )
    report = {f"{name}_microseconds": round(value, 2) for name, value in times.items()}
    report["update_over_pinocchio"] = round(times["update"] / times["update_pinocchio"], 3)
    report["solve_over_pinocchio"] = round(times["solve"] / times["solve_pinocchio"], 3)
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
