# %% [markdown]
# # 3. Your spacecraft and your log
#
# You have a model file of your spacecraft, and a log of its motion with the target. This tutorial
# identifies the target from the log, tests the answer with samples that were not used, and brings
# the result back into Drake. It uses the shipped log; replace three lines by your own files.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import cpid_drake as cpid

models = cpid.models_directory()
spacecraft = cpid.Spacecraft(  # your URDF, SDF, MJCF or directives, without the target
    models / "free_flyer/free_flyer.urdf", base="body", capture_frame="capture_point"
)
log = cpid.read_log(models / "telemetry/free_flyer.csv")  # your log
sensors = cpid.load_sensors("testbed")  # what you know of your sensors: a preset or a YAML file
print(spacecraft.joint_names, f"{spacecraft.mass:.3f} kg")
print(log)

# %% [markdown]
# ## Look at the log
#
# Each sensor has samples at its own times. Look at them before anything else: do the joints move,
# and does the base turn about more than one axis?

# %%
figure, (above, below) = plt.subplots(2, 1, figsize=(7, 4.5), sharex=True, layout="constrained")
above.plot(log.encoders.time, log.encoders.value, label=log.joint_names)
above.set(ylabel="joints [rad]")
above.legend(ncols=4, fontsize="small")
below.plot(log.gyro.time, np.degrees(log.gyro.value), label=["x", "y", "z"])
below.set(xlabel="time [s]", ylabel="gyro [deg/s]")
below.legend(ncols=3, fontsize="small")
plt.show()

# %% [markdown]
# ## Identify
#
# `identify` fits the target, the sensors' errors and the motion to all samples. It prints failed
# checks and warnings first, then each parameter with its 95 % interval. The last lines are the
# error budget: which error of your hardware makes the interval wide.

# %%
found = cpid.identify(spacecraft, log, sensors=sensors)
print(found)

assert found.passed
assert found.is_complete
low, high = found["m"].interval
assert low < 8.5 < high  # the bag of this log has 8.5 kg

# %% [markdown]
# In a notebook, `found.plot()` draws each parameter with its interval; `cpid identify --report`
# writes a page with it, and `cpid report` one of a result that was kept.
#
# ## A log with other columns
#
# The same motion, as another tool wrote it: nanoseconds, millimetres, degrees, another order of the
# quaternion. A `ColumnMap` says what is different. `cpid log map` writes such a map for you.

# %%
folder = Path(tempfile.mkdtemp())
(folder / "map.yaml").write_text("""
time: {column: field.header.stamp, unit: ns, epoch: 1767225600000000000}
attitude:
  columns: [field.pose.orientation.x, field.pose.orientation.y,
            field.pose.orientation.z, field.pose.orientation.w]
  order: xyzw
position:
  columns: [field.pose.position.x, field.pose.position.y, field.pose.position.z]
  unit: mm
angular_velocity:
  columns: [field.angular_velocity.x, field.angular_velocity.y, field.angular_velocity.z]
  unit: deg/s
  frame: body
joint_positions:
  columns: {arm_joint1: arm_joint1/position, arm_joint2: arm_joint2/position,
            arm_joint3: arm_joint3/position, arm_joint4: arm_joint4/position}
  unit: deg
""")
other = cpid.read_log(models / "telemetry/free_flyer_ros.csv", columns=folder / "map.yaml")
print(other)
print(cpid.identify(spacecraft, other, sensors=sensors)["m"])

# %% [markdown]
# ## Test the answer
#
# Identify from the first half of the log and predict the second. `validate` compares the target
# with the log that was not used. A wrong target fails.

# %%
first = cpid.identify(spacecraft, log.between(0.0, 5.0), sensors=sensors)
tested = cpid.validate(spacecraft, first, log.between(5.0, 10.0), sensors=sensors)
print(f"χ² {tested.chi_squared:.1f} of {tested.freedom}: probability {tested.probability:.2f}")
print(f"A target {tested.heavier:.1%} heavier would be noticed.")
for error in tested.errors:
    print(f"{error.sensor:9} predicted to {error.rms:.3g} {error.unit}, noise {error.noise:.3g}")

assert tested.is_target_right

# %% [markdown]
# The same test with a target that is 20 % heavier than it should be:

# %%
wrong = first.parameters * np.where(np.arange(10) == 0, 1.2, 1.0)
prior = cpid.TargetPrior("too heavy", wrong, first.covariance)
tested = cpid.validate(spacecraft, prior, log.between(5.0, 10.0), sensors=sensors)
print(f"χ² {tested.chi_squared:.0f} of {tested.freedom}: probability {tested.probability:.1g}")

assert not tested.is_target_right

# %% [markdown]
# ## Use the answer
#
# `consistent` is the nearest target that a rigid body can be. The spacecraft with this target is a
# `MultibodyPlant`, for control and simulation. `export_target` writes it as a model file.

# %%
target = found.consistent
plant = spacecraft.make_simulation_plant(target)
print(f"together {plant.CalcTotalMass(plant.CreateDefaultContext()):.2f} kg")

cpid.export_target(folder / "bag.urdf", target, format="urdf")
print((folder / "bag.urdf").read_text(encoding="utf-8"))
