"""The one exception that means "the input is wrong": its text is one clear sentence for the user."""


class InputError(ValueError):
    """Bad input from outside (a file, an option, an array); the command line prints it and exits with status 2.

    Example:
        >>> import rcbht_jax as rj
        >>> try:
        ...     rj.preset("r2d2")
        ... except rj.InputError as error:
        ...     str(error).split(";")[0]
        "Robot 'r2d2' has no thresholds"

    Attributes:
        fault: the text without the advice that a caller may know better.
    """

    def __init__(self, fault: str, advice: str = "") -> None:
        """State what is wrong, and apart from it what helps unless a caller knows something better; "" = nothing."""
        super().__init__(f"{fault} {advice}".rstrip())
        self.fault = fault
