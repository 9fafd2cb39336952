"""Which devices of this machine a command uses."""

from __future__ import annotations

from rcbht_jax.errors import InputError


def checked(devices: str) -> str:
    """The value of an option such as ``--devices all``.

    Raises:
        InputError: neither "all" nor a number.
    """
    if devices != "all" and not (devices.isdecimal() and int(devices)):
        raise InputError(f'--devices is {devices!r}; expected "all", or a number of GPUs.')
    return devices


def wanted(devices: str, present: int) -> int:
    """How many of the devices present such an option asks for.

    Raises:
        InputError: neither "all" nor a number, or more than there are.

    Example:
        >>> wanted("all", 4), wanted("2", 4)
        (4, 2)
    """
    count = present if checked(devices) == "all" else int(devices)
    if count > max(1, present):
        raise InputError(f"--devices is {count}; this machine has {present}.")
    return count
