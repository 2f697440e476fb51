#!/usr/bin/env python3
"""Watch the capture in Meshcat: arms, target, and the inertia that the identifier believes in.

The wire ellipsoid is the estimated inertia, the translucent one the truth. It appears when all ten
parameters have been determined.
"""

import argparse
import sys
import time
from pathlib import Path

from pydrake.geometry import StartMeshcat

from cpid_drake import InputError, load_scenario, make_simulation, shipped_scenario


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default=shipped_scenario("paper"), help="scenario YAML file")
    parser.add_argument("--rate", type=float, default=1.0, help="real-time rate; 0: full speed")
    parser.add_argument("--html", metavar="FILE", help="write the recording here and stop")
    args = parser.parse_args()
    html = Path(args.html).absolute() if args.html else None
    if html and (html.is_dir() or not html.parent.is_dir()):
        parser.exit(2, f"{parser.prog}: error: --html {args.html}: not a file in a folder\n")
    try:
        scenario = load_scenario(args.scenario)
        make_simulation(scenario)  # complains, if it does, before a browser is opened
        meshcat = StartMeshcat()
        simulation = make_simulation(scenario, meshcat=meshcat)
    except InputError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")
    meshcat.SetProperty("/Background/<object>", "top_color", [0.02, 0.02, 0.06])
    meshcat.SetProperty("/Background/<object>", "bottom_color", [0.05, 0.05, 0.12])
    meshcat.SetProperty("/Grid", "visible", False)
    meshcat.SetProperty("/Axes", "visible", False)
    meshcat.SetCameraPose(camera_in_world=[4.6, -3.6, 1.8], target_in_world=[1.0, 0.0, -0.4])

    if not args.html:
        print(f"Open {meshcat.web_url()}", file=sys.stderr)
        meshcat.AddButton("Stop", "Escape")
    meshcat.StartRecording(set_visualizations_while_recording=not args.html)
    simulator = simulation.make_simulator()
    simulator.set_target_realtime_rate(0.0 if args.html else args.rate)
    simulator.AdvanceTo(simulation.scenario.simulation.duration)
    simulator.AdvancePendingEvents()
    meshcat.StopRecording()
    meshcat.PublishRecording()

    identifier = simulation.identifier
    context = identifier.GetMyContextFromRoot(simulator.get_context())
    print(identifier.identification(context).explain())
    if args.html:
        html.write_text(meshcat.StaticHtml(), encoding="utf-8")
        return
    print("The recording plays in the browser; press Stop (Escape) there to end.", file=sys.stderr)
    while meshcat.GetButtonClicks("Stop") == 0:
        time.sleep(0.2)


if __name__ == "__main__":
    main()
