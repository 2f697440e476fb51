"""The measurement model: motion of the base, sensors, gyro bias, errors of joints and bodies."""
