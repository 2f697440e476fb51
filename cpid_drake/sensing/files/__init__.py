"""Telemetry files: CSV, NPZ, Parquet and ROS 2 bags."""
