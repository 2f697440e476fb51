from .run import run_campaign

__all__ = ["run_campaign"]
