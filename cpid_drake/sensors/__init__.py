"""What measures: the sensors, their errors, and the disturbances while they measure."""
