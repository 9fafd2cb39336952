"""The commands of ``rcbht``, one module each.

A command is a frozen dataclass derived from :class:`Command`; its fields are the options, its docstring is
the help text and holds an example. It is entered in the table of ``rcbht_jax.cli.main``, which imports its module
only when the command is called.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Command(ABC):
    """Base of all commands: ``run`` computes, ``text`` words the result for people."""

    @abstractmethod
    def run(self) -> dict[str, Any]:
        """Do the work and return the result as JSON values.

        Raises:
            InputError: the input is wrong; its text is shown and the exit status is 2.
        """

    @abstractmethod
    def text(self, result: dict[str, Any]) -> str:
        """The result of :meth:`run` as text for the terminal."""
