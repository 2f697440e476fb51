from .trials import fit_errors, make_case

__all__ = ["fit_errors", "make_case"]
