from .checked_log import log_of_states

__all__ = ["log_of_states"]
