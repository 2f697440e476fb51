#!/usr/bin/env python3
"""Watch the capture in Meshcat: arms, target, momentum, and the inertia that is identified.

The wire ellipsoid shows the estimated inertia, the translucent one the true inertia. The estimate
appears when all ten parameters are determined. `cpid view` does the same with controls in the page.
"""

import argparse
import sys
import time
from pathlib import Path

from pydrake.geometry import StartMeshcat

from cpid_drake import InputError, load_scenario, make_simulation, shipped_scenario
from cpid_drake.report.replay import replay_simulation


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default=shipped_scenario("paper"), help="scenario YAML file")
    parser.add_argument("--rate", type=float, default=1.0, help="real-time rate; 0: full speed")
    parser.add_argument("--html", metavar="FILE", help="write a replay here and stop")
    args = parser.parse_args()
    html = Path(args.html).absolute() if args.html else None
    if html and (html.is_dir() or not html.parent.is_dir()):
        parser.exit(2, f"{parser.prog}: error: --html {args.html}: not a file in a folder\n")
    try:
        scenario = load_scenario(args.scenario)
        simulation = make_simulation(scenario)  # finds errors before a browser is opened
        if html:
            page, identification = replay_simulation(simulation, title=Path(args.scenario).stem)
            html.write_text(page, encoding="utf-8")
            print(identification.explain())
            return
        meshcat = StartMeshcat()
        simulation = make_simulation(scenario, meshcat=meshcat)
    except InputError as error:
        parser.exit(2, f"{parser.prog}: error: {error}\n")

    print(f"Open {meshcat.web_url()}", file=sys.stderr)
    meshcat.AddButton("Stop", "Escape")
    meshcat.StartRecording()
    simulator = simulation.make_simulator()
    simulator.set_target_realtime_rate(args.rate)
    simulator.AdvanceTo(scenario.simulation.duration)
    simulator.AdvancePendingEvents()
    meshcat.StopRecording()
    meshcat.PublishRecording()
    print(simulation.identification(simulator.get_context()).explain())
    print("The recording plays in the browser; press Stop (Escape) there to end.", file=sys.stderr)
    while meshcat.GetButtonClicks("Stop") == 0:
        time.sleep(0.2)


if __name__ == "__main__":
    main()
