"""The commands that encode by either rule of words: their options, and the limits that these choose."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rcbht_jax.cli import common
from rcbht_jax.cli.command import Command, MadeBy, option
from rcbht_jax.errors import InputError

if TYPE_CHECKING:
    from rcbht_jax.encoding.rules import AnyConfig, AnyLimits
    from rcbht_jax.types import Recordings


@dataclass(frozen=True, kw_only=True)
class RuleCommand(Command):
    """Options of the commands that encode by either rule."""

    window: Annotated[int, option("Samples per linear fit.")] = 5
    robot: Annotated[
        common.RobotName | None,
        option(
            "Robot whose preset gives the gradient thresholds; auto = from rest and contacts in what is encoded.",
            "hiro for recordings of HIRO and simulated ones, else auto",
        ),
    ] = None
    thresholds: Annotated[
        Path | None,
        option(
            'File of "rcbht calibrate" to use instead of the preset: gradient thresholds and, if it was made for '
            "--rule fit, tolerances.",
            "",
            metavar="FILE.json",
        ),
        MadeBy('"rcbht calibrate STORE.zarr -o {path}"'),
    ] = None
    rule: common.WordRule = "paper"
    tolerance: Annotated[
        tuple[float, ...], option(common.TOLERANCE, f"those of --thresholds; else {common.AUTO_TOLERANCE}")
    ] = ()

    def check_inputs(self) -> None:
        """Refuse two choices of thresholds as well."""
        super().check_inputs()
        if self.robot is not None and self.thresholds is not None:
            raise InputError("--robot and --thresholds both choose thresholds; leave out one of them.")

    def read_limits(self, recordings: Recordings, store: Path, scale: float = 1.0) -> tuple[AnyLimits, dict[str, Any]]:
        """The limits of the file, of a robot's preset or of these recordings, and where they come from.

        Args:
            recordings, store: what is encoded, and where it is stored.
            scale: factor on all gradient limits.

        Returns:
            gradient thresholds, or FitLimits of a file for the fit rule.

        Raises:
            InputError: the file is missing or damaged, or has no limits for an axis, or for its unit.
        """
        from rcbht_jax.calibration.rest import auto_thresholds
        from rcbht_jax.encoding.rules import scaled
        from rcbht_jax.encoding.thresholds import preset

        if self.thresholds:
            thresholds, source = self.limits_in_file(self.thresholds, recordings, store)
        elif (robot := self.robot or _robot(recordings, store)) == "auto":
            thresholds, source = auto_thresholds(recordings, self.window, self.rule), {"method": "auto"}
        else:
            thresholds, source = preset(robot, recordings.axes, recordings.units), {"method": "preset", "robot": robot}
        return (thresholds, source) if scale == 1 else (scaled(thresholds, scale), {**source, "scale": scale})

    def limits_in_file(self, file: Path, recordings: Recordings, store: Path) -> tuple[AnyLimits, dict[str, Any]]:
        """Limits of a file of ``rcbht calibrate``; arguments and errors as of :meth:`read_limits`."""
        from rcbht_jax.encoding.limit_files import read_limits

        return read_limits(file, recordings.axes, recordings.units, self.rule)

    def config(self, dt: float) -> AnyConfig:
        """The configuration of the rule for samples ``dt`` seconds apart."""
        from rcbht_jax.encoding.rules import config_of

        return config_of(self.rule, self.window, dt)

    def limits(self, config: AnyConfig, thresholds: AnyLimits, training: Recordings) -> AnyLimits:
        """The thresholds and, by the fit rule, the tolerances: those of the option, or of these recordings."""
        from rcbht_jax.encoding.rules import limits_for

        tolerance = checked_tolerance(self.rule, self.tolerance, len(training.axes))
        return limits_for(config, thresholds, tolerance, training.wrench, training.length)


def checked_tolerance(rule: str, tolerance: tuple[float, ...], axes: int | None = None) -> tuple[float, ...] | None:
    """The option --tolerance as :func:`rcbht_jax.encoding.rules.limits_for` takes it; None = from recordings.

    Args:
        rule: of the words.
        tolerance: the option.
        axes: how many there are; None = not known yet.
    """
    if tolerance and rule != "fit":
        raise InputError("--tolerance is for --rule fit; add that, or leave it out.")
    if axes is not None and len(tolerance) not in (0, 1, axes):
        raise InputError(f"--tolerance has {len(tolerance)} numbers; expected one, or {axes}, one for each axis.")
    return tolerance or None


def _robot(recordings: Recordings, store: Path) -> str:
    """HIRO where the store is an import of its trials or a simulation of them; else its limits are unknown."""
    from rcbht_jax.io.joining import importer_of
    from rcbht_jax.io.store import read_attrs
    from rcbht_jax.labels import AXES

    return "hiro" if recordings.axes == AXES and importer_of(read_attrs(store)) == "hiro" else "auto"
