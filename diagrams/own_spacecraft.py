#!/usr/bin/env python3
"""Identify the target of your own spacecraft from your own log, and use the result in Drake.

Give your files. The default is the shipped sample: a free-flyer that moves a bag.
"""

import argparse

from pydrake.multibody.tree import BodyIndex

from cpid_drake import (
    InputError,
    Spacecraft,
    identify,
    load_sensors,
    models_directory,
    read_log,
)


def main() -> None:
    models = models_directory()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("telemetry", nargs="?", default=models / "telemetry/free_flyer.csv")
    parser.add_argument("--model", default=models / "free_flyer/free_flyer.urdf")
    parser.add_argument("--base", default="body")
    parser.add_argument("--capture-frame", default="capture_point")
    parser.add_argument("--sensors", default="testbed", help="preset or YAML file")
    args = parser.parse_args()
    try:
        # The inputs: the spacecraft model, the log and the sensors.
        spacecraft = Spacecraft(args.model, base=args.base, capture_frame=args.capture_frame)
        log, sensors = read_log(args.telemetry), load_sensors(args.sensors)
        found = identify(spacecraft, log, sensors=sensors)
        print(found.explain())
        target = found.consistent  # InertialParameters that a rigid body can have
    except InputError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")
    if target is None:
        parser.exit(3)  # what is not determined is printed above
    print(f"m = {target.mass:.4f} kg, c = {target.p_CTcm_C.round(4)} m")
    print(f"I = {target.I_TTcm_C.round(5).tolist()} kg·m²")

    # The spacecraft with its target as a Drake plant, for control, planning and simulation. This
    # example computes the inertia about the common centre of mass, which attitude control needs.
    plant = spacecraft.make_simulation_plant(target)
    context = plant.CreateDefaultContext()
    base = plant.GetBodyByName(spacecraft.base.name())
    bodies = [BodyIndex(k) for k in range(1, plant.num_bodies())]
    together = plant.CalcSpatialInertia(context, base.body_frame(), bodies)
    centred = together.Shift(together.get_com()).CalcRotationalInertia()
    print(f"together {together.get_mass():.3f} kg, {centred.get_moments().round(3)} kg·m²")


if __name__ == "__main__":
    main()
