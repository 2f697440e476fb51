"""The study of Ning et al. 2016, from simulation to its page; `run.py` makes all of it."""
