"""The one exception that means "the input is wrong": its text is one clear sentence for the user."""


class InputError(ValueError):
    """Bad input from outside (a file, an option, an array); the command line prints it and exits with status 2."""
