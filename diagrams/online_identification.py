#!/usr/bin/env python3
"""Wire an identifier into a Diagram of your own and watch the estimate converge.

joint motion -> joint controller -> plant (zero gravity) -> sensors -> identifier, one by one.
The sensors are the simplest possible ones: they round the state to a number of decimals.
"""

import argparse

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, VectorSystem

from cpid_drake import (
    PARAMETER_NAMES,
    PARAMETER_UNITS,
    HalfCosine,
    InertialParameters,
    JointController,
    JointMotionSource,
    MomentumIdentifier,
    Spacecraft,
)

MODEL = "package://cpid_drake_models/dual_arm_servicer/dual_arm_servicer.urdf"


class RoundingSensors(VectorSystem):
    """Outputs the spacecraft's state [q; v] rounded to a number of decimals, in SI units."""

    def __init__(self, size: int, decimals: int) -> None:
        super().__init__(size, size, direct_feedthrough=True)
        self._decimals = decimals

    def DoCalcVectorOutput(self, context, u, x, y) -> None:  # noqa: D102
        y[:] = np.round(u, self._decimals)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--rows", choices=["eq18", "standard"], default="standard", help="row family"
    )
    parser.add_argument("--period", type=float, default=0.5, help="sampling period [s]")
    parser.add_argument("--decimals", type=int, default=5, help="of the measured state")
    args = parser.parse_args()
    if not 3 <= args.decimals <= 15:
        parser.exit(2, f"{parser.prog}: error: --decimals must be 3 to 15\n")
    if not 0 < args.period <= 10:
        parser.exit(2, f"{parser.prog}: error: --period must be > 0 and at most 10 s\n")

    # The spacecraft is known; the target, here a tank of 60 kg, is to be identified.
    spacecraft = Spacecraft(MODEL, base="bus", capture_frame="capture_point")
    tank = InertialParameters(60.0, [0.5, 0.05, -0.1], np.diag([6.0, 9.0, 8.0]))

    builder = DiagramBuilder()
    plant = builder.AddSystem(MultibodyPlant(time_step=0.0))
    spacecraft.add_to(plant, tank)
    state = plant.get_state_output_port()

    start = np.array([0.2, 0.3, 1.0, 0.0, -0.6, 0.0] + [-0.3, -1.5, 2.4, 0.0, -0.9, 0.0])
    end = np.array([-0.8, -1.2, 0.7, 1.8, 0.8, -1.0] + [-1.5, -1.3, 0.6, -1.0, 0.5, 1.0])
    motion = HalfCosine(start, end, duration=10.0)
    source = builder.AddSystem(JointMotionSource(motion))
    # The controller does not know the tank: it assumes a sphere of 100 kg.
    sphere = InertialParameters(100.0, np.zeros(3), 10.0 * np.eye(3))
    JointController.AddToBuilder(
        builder,
        spacecraft,
        state=state,
        desired_motion=source.get_output_port(),
        generalized_force=plant.get_applied_generalized_force_input_port(),
        target=sphere,
    )

    sensors = builder.AddSystem(RoundingSensors(state.size(), args.decimals))
    builder.Connect(state, sensors.get_input_port())
    identifier = MomentumIdentifier.AddToBuilder(
        builder,
        spacecraft,
        state=sensors.get_output_port(),
        rows=args.rows,
        period=args.period,
        offset=args.period,
    )
    diagram = builder.Build()

    simulator = Simulator(diagram)
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    root_context = simulator.get_mutable_context()
    plant_context = plant.GetMyMutableContextFromRoot(root_context)
    plant.SetPositionsAndVelocities(plant_context, spacecraft.initial_state(tank, motion))
    context = identifier.GetMyContextFromRoot(root_context)

    print("time [s]  rank     m [kg] ± σ                       c [m]       Ixx, Iyy, Izz [kg·m²]")
    for time in np.arange(args.period, 10.0 + 1e-9, args.period):
        simulator.AdvanceTo(time)
        simulator.AdvancePendingEvents()
        m, *rest = identifier.GetOutputPort("parameters").Eval(context)
        sigma = np.sqrt(identifier.GetOutputPort("covariance").Eval(context)[0])
        rank = identifier.GetOutputPort("diagnostics").Eval(context)[1]
        c = " ".join(f"{value:7.4f}" for value in rest[:3])
        moments = " ".join(f"{value:8.4f}" for value in rest[3:6])
        print(f"{time:8.2f}  {rank:4.0f} {m:10.5f} ± {sigma:<8.2g}  {c}  {moments}")
    result = identifier.identification(context)
    print(f"\n{result.explain()}")
    print(f"{'':12}{'estimate':>12}{'std. deviation':>18}{'truth':>12}")
    deviations = np.sqrt(np.diag(result.covariance))
    table = zip(PARAMETER_NAMES, PARAMETER_UNITS, result.parameters, deviations, tank.to_vector())
    for name, unit, estimate, deviation, truth in table:
        print(f"{f'{name} [{unit}]':12}{estimate:12.5f}{deviation:18.1e}{truth:12.5f}")


if __name__ == "__main__":
    main()
