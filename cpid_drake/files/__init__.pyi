from .checked_yaml import load_yaml, nulls
from .overwriting import check_folder
from .pictures import COLORS, INK, Picture, curves, label_axes, legend_below

__all__ = [
    "COLORS",
    "INK",
    "Picture",
    "check_folder",
    "curves",
    "label_axes",
    "legend_below",
    "load_yaml",
    "nulls",
]
