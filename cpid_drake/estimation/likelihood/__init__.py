"""The measurement model: motion of the base, sensors, errors of sensors, joints and bodies."""
