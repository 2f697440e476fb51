#!/usr/bin/env python3
"""Identify online without a Diagram: messages of a robot, one at a time, in any order.

Here they come from the sample log, mixed up by as much as a tenth of a second.
"""

import random

import cpid_drake as cpid

folder = cpid.models_directory() / "telemetry"
spacecraft = cpid.load_spacecraft("free_flyer_payload").make()
log = cpid.read_log(folder / "free_flyer.csv")
messages = sorted(log.messages(), key=lambda message: message[1] + random.uniform(0.0, 0.1))

sensors = cpid.load_sensors(folder / "free_flyer_sensors.yaml")
identifier = cpid.OnlineIdentifier(spacecraft, sensors)
second = 0
for sensor, time, value in messages:
    identifier.add(sensor, time, value)
    if time >= second + 1:
        second = int(time)
        found = identifier.estimate()
        sigma = found.covariance[0, 0] ** 0.5
        print(f"{second:3} s  m = {found.parameters[0]:8.4f} kg ± {1.96 * sigma:.4f}")
found = identifier.finish()
print(found, found.explain(), sep="\n")
