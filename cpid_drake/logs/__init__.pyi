from .log import Samples, sample_times
from .simulated_noise import add_noise
from .smoothing import smooth
from .splines import regression_spline

__all__ = [
    "Samples",
    "add_noise",
    "regression_spline",
    "sample_times",
    "smooth",
]
