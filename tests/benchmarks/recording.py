#!/usr/bin/env python3
"""Time a recorded run against the same run without drawing, and a replay of it.

Recorded: the scene is drawn into Meshcat's recording at every frame. Replay: the page that
`cpid view --html` writes, made from the run's telemetry.
"""

import argparse
import json
import statistics
import time

import numpy as np
from pydrake.geometry import Meshcat

from cpid_drake import load_scenario, make_simulation, shipped_scenario
from cpid_drake.report.replay import replay_html


def main() -> None:
    """Check that the runs agree, time them in turn and print the result as JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenario", default="paper")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--duration", type=float, help="simulate this long instead [s]")
    args = parser.parse_args()

    scenario = load_scenario(shipped_scenario(args.scenario))
    if args.duration is not None:
        scenario.simulation.duration = args.duration
    meshcat = Meshcat()
    plain, drawn = make_simulation(scenario), make_simulation(scenario, meshcat=meshcat)

    def run():
        return plain.run()

    def recorded_run():
        meshcat.DeleteRecording()
        meshcat.StartRecording(set_visualizations_while_recording=False)
        context = drawn.run()
        meshcat.StopRecording()
        meshcat.PublishRecording()
        return context

    context = run()
    telemetry, found = plain.motion(context), plain.identification(context)
    recorded = drawn.motion(recorded_run())
    np.testing.assert_allclose(telemetry.p_WB, recorded.p_WB, rtol=0, atol=1e-7)

    def replay():
        return replay_html(
            plain.spacecraft, telemetry, [(telemetry.time[-1], found)], truth=plain.truth
        )

    samples: dict[str, list[float]] = {"run": [], "recorded_run": [], "replay": []}
    for _ in range(args.repeats):
        for work in (run, recorded_run, replay):
            start = time.process_time()
            work()
            samples[work.__name__].append(time.process_time() - start)
    seconds = {name: statistics.median(times) for name, times in samples.items()}
    report = {f"{name}_seconds": round(value, 3) for name, value in seconds.items()}
    for name in ("recorded_run", "replay"):
        ratios = np.array(samples[name]) / np.array(samples["run"])
        report[f"{name}_over_run"] = round(float(np.median(ratios)), 3)
    report["replay_megabytes"] = round(len(replay()) / 1e6, 2)
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
