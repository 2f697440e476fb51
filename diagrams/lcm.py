#!/usr/bin/env python3
"""Identify from LCM messages: a Diagram beside a robot, on one bus.

The robot is the sample log here, and the bus is in memory. With `DrakeLcm()` the Diagram runs
alone, in real time, with the messages of a robot elsewhere.
"""

from drake import lcmt_scope
from pydrake.lcm import DrakeLcm, Subscriber
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

import cpid_drake as cpid

folder = cpid.models_directory() / "telemetry"
spacecraft = cpid.load_spacecraft("free_flyer_payload").make()
sensors = cpid.load_sensors(folder / "free_flyer_sensors.yaml")

lcm, builder = DrakeLcm("memq://"), DiagramBuilder()
identifier = cpid.SensorIdentifier(spacecraft, sensors, period=0.002)
cpid.add_lcm(builder, identifier, lcm=lcm, period=1.0)  # CPID_GYRO in, CPID_PARAMETERS out, ...
simulator = Simulator(builder.Build())
# simulator.set_target_realtime_rate(1.0); simulator.AdvanceTo(60.0)  # with a robot elsewhere

second = 0
for sensor, time, value in cpid.read_log(folder / "free_flyer.csv").messages():
    if time > simulator.get_context().get_time():
        lcm.HandleSubscriptions(0)
        simulator.AdvanceTo(time)
    message = lcmt_scope()
    message.utime, message.value = round(1e6 * time), [time, *value]
    message.size = len(message.value)
    lcm.Publish(f"CPID_{sensor.upper()}", message.encode())
    if time >= second + 1:
        second = int(time)
        known = identifier.identification(identifier.GetMyContextFromRoot(simulator.get_context()))
        sigma = known.covariance[0, 0] ** 0.5
        print(f"{second:3} s  m = {known.parameters[0]:8.4f} kg ± {1.96 * sigma:.4f}")
lcm.HandleSubscriptions(0)
simulator.AdvanceTo(simulator.get_context().get_time() + 0.01)
found = identifier.Finish(simulator.get_mutable_context())
print(found, found.explain(), sep="\n")

# What another process hears. In this one, subscribe after the simulation: Drake calls a
# `Subscriber` of its own bus without Python's lock.
heard = Subscriber(lcm, "CPID_PARAMETERS", lcmt_scope)
simulator.get_system().ForcedPublish(simulator.get_context())
lcm.HandleSubscriptions(0)
print("CPID_PARAMETERS:", *(f"{value:.4f}" for value in heard.message.value))
