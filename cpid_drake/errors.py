"""The one exception type that bad input raises."""


class InputError(ValueError):
    """Something the caller supplied (model, scenario, data, option) cannot be used.

    The message is one line that says what was wrong, where, and what to do. The command line
    prints it as it stands and exits with code 2.
    """

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))
