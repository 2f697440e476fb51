from .log import Samples, sample_times
from .smoothing import smooth
from .splines import regression_spline

__all__ = [
    "Samples",
    "regression_spline",
    "sample_times",
    "smooth",
]
