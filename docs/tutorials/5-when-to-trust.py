# %% [markdown]
# # 5. When to trust an answer
#
# An estimate is as good as what you say of your hardware. This tutorial spoils a log in three ways:
# a joint with the wrong sign, a star tracker that is late, and a leak. It shows what the checks
# find, what they cannot find, and what the error budget says.

# %%
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import cpid_drake as cpid
from cpid_drake.logs.log import Samples
from cpid_drake.logs.simulated_noise import add_noise
from cpid_drake.simulation.trials import ideal_samples, make_case

scenario = cpid.load_scenario(cpid.shipped_scenario("free_flyer_payload"))
spacecraft, truth = scenario.spacecraft.make(), scenario.target_truth()

# %% [markdown]
# ## Two statements about the same sensors
#
# Both suites have the noise of a laboratory. `unstated="exact"` adds: nothing else is wrong,
# neither with the sensors nor with the spacecraft's masses. Without it, each error that the file
# does not name has a plausible size, and the spacecraft's bodies are known to about a percent.

# %%
exact = cpid.load_sensors("testbed", unstated="exact")
plausible = cpid.load_sensors("testbed")
case = make_case(scenario, spacecraft, truth, exact, seed=1)


def simulated(case):
    """Return the noisy samples of a case."""
    return add_noise(exact, ideal_samples(case, spacecraft.tree, spacecraft.joint_names), seed=1)


log = simulated(case)
results = {}


def compare(name, log, suites=("exact", "plausible")):
    """Identify with both statements, and print mass, error and the first failed check."""
    for which, suite in (("exact", exact), ("plausible", plausible)):
        if which in suites:
            found = results[name, which] = cpid.identify(spacecraft, log, sensors=suite)
            sigma = np.sqrt(np.diag(found.covariance))
            error = np.abs((found.parameters - truth.to_vector()) / sigma).max()
            print(f"{name}, {which}: {found['m']}; worst error {error:.1f} σ")
            print("   ", found.failures[0] if found.failures else "all checks passed")


compare("nothing wrong", log)
assert all(found.passed for found in results.values())

# %% [markdown]
# With nothing wrong, both are right. The plausible suite has an interval that is seven times as
# wide: that is the price of the errors that may be there.
#
# ## A joint with the wrong sign
#
# One encoder counts backwards. No force explains such a log, and another sign does. The log is
# refused before anything is fitted. The sentence names the joint and what to write into the map of
# columns.

# %%
signs = np.array([-1.0, 1.0, 1.0, 1.0])
backwards = Samples(log.encoders.time, log.encoders.value * signs)
refused = ""
try:
    cpid.identify(spacecraft, log.updated({"encoders": backwards}), sensors=exact)
except cpid.InputError as error:
    refused = str(error)
print(refused)

assert "arm_joint1" in refused

# %% [markdown]
# ## A late star tracker
#
# The stamps of the attitude are 20 ms late. If you state that the stamps are exact, the error looks
# like slow noise: the interval is wider, and a warning names the delay. If you state nothing, the
# delay of each sensor is an unknown, and the answer is the one without the delay. Only the
# differences of the delays are identifiable.

# %%
late = Samples(log.attitude.time + 0.02, log.attitude.value)
compare("late tracker", log.updated({"attitude": late}))
for effect in results["late tracker", "plausible"].effects:
    if effect.name.endswith("delay"):
        print(f"{effect.name}: {effect.value[0]:.1f} ± {effect.sigma[0]:.1f} {effect.unit}")

warnings = results["late tracker", "exact"].warnings
print(*warnings, sep="\n")

assert "20 ms later" in warnings[0]
assert results["late tracker", "plausible"].passed

# %% [markdown]
# ## A leak
#
# A valve leaks: a constant force and a constant torque act. A leak of 2 mN looks like slow noise of
# all sensors: warnings say so, and a check finds that the momentum changes. A leak of 0.15 mN
# leaves no trace. The statement "no force acts" is false, all checks pass, and the answer is off by
# many of its σ. No check can find an error that looks like another target. With the plausible suite
# the interval contains the truth.


# %%
def leaking(force):
    """Return a log with a leak [N] at a lever arm of 0.2 m."""
    torque, acceleration = np.array([0, 0, 0.2 * force]), np.array([force, 0, 0]) / 19.0
    return simulated(replace(case, torque_W=torque, acceleration_W=acceleration))


compare("leak of 2 mN", leaking(2e-3))
compare("leak of 0.15 mN", leaking(0.15e-3))


def off(name, which):
    """Return the largest error of a result in its own σ."""
    found = results[name, which]
    sigma = np.sqrt(np.diag(found.covariance))
    return np.abs((found.parameters - truth.to_vector()) / sigma).max()


warnings = results["leak of 2 mN", "exact"].warnings
print(*warnings, sep="\n")

assert any("correlated in time" in warning for warning in warnings)
assert not results["leak of 2 mN", "exact"].passed
assert results["leak of 0.15 mN", "exact"].passed
assert off("leak of 0.15 mN", "exact") > 4  # a false statement is not forgiven
assert off("leak of 0.15 mN", "plausible") < 3

# %%
figure, axis = plt.subplots(figsize=(8, 3.2), layout="constrained")
for k, key in enumerate(results):
    found = results[key]
    color = "C0" if found.passed else "C3"
    axis.errorbar(k, found["m"].value, 1.96 * found["m"].sigma, fmt="o", color=color, capsize=4)
axis.axhline(truth.mass, color="0.5", zorder=0)
axis.set_xticks(range(len(results)), ["\n".join(key) for key in results], fontsize=7)
axis.set(ylabel="mass [kg], 95 %", title="red: a check failed")
plt.show()

# %% [markdown]
# ## The error budget
#
# Most of the interval does not come from noise. The budget says which error it comes from, and how
# well you must know this error to halve its share. The first rows here are masses and inertias of
# the spacecraft's bodies: weigh them.

# %%
found = results["nothing wrong", "plausible"]
for row in sorted(found.budget, key=lambda row: -row.shares[0])[:5]:
    print(f"{row.name:32} share of the variance of m: {100 * row.shares[0]:3.0f} %")

weighed = cpid.BodyUncertainty(mass=0.001, com=0.001, inertia=0.001)
better = cpid.identify(spacecraft, log, sensors=plausible, known_bodies=weighed)
print(f"σ of the mass: {found['m'].sigma:.3f} kg; with weighed bodies {better['m'].sigma:.3f} kg")

assert better["m"].sigma < 0.7 * found["m"].sigma

# %% [markdown]
# ## What no check finds
#
# If all masses of the spacecraft's model are too large by one factor, the target's are too, and
# nothing in the log shows it. State what is uncertain, test the answer with a log that was not used
# ([tutorial 3](3-your-log)), and read [whether to trust the answer](../explanation/trust.md).
