"""Recorded sessions as data, by name."""

from __future__ import annotations

from rcbht_jax.errors import InputError
from sim_mjx.presets.camera import HOOKED_A, HOOKED_B, HOOKED_C
from sim_mjx.presets.openhrp import OPENHRP, RIGID
from sim_mjx.presets.session import SessionPreset
from sim_mjx.presets.session_a import SESSION_A
from sim_mjx.presets.session_b import SESSION_B
from sim_mjx.presets.session_c import SESSION_C
from sim_mjx.presets.two_arm import TWO, TWO_FIXED

ONE_ARM = {preset.name: preset for preset in (SESSION_A, SESSION_B, SESSION_C, OPENHRP)}
HOOKED = {preset.name: preset for preset in (HOOKED_A, HOOKED_B, HOOKED_C)}  # with one set of parts, whose hooks catch
TWO_ARM = {preset.name: preset for preset in (TWO, TWO_FIXED)}
PRESETS: dict[str, SessionPreset] = {**ONE_ARM, **HOOKED, RIGID.name: RIGID, **TWO_ARM}
DEFAULT = HOOKED_B.name  # its tabs let go as recorded ones do


def preset(name: str) -> SessionPreset:
    """The constants of a recorded session.

    Args:
        name: one of ``PRESETS``.

    Raises:
        InputError: unknown name.

    >>> preset("A").mating_begins
    16.32
    """
    if name not in PRESETS:
        raise InputError(f"There is no preset {name!r}; expected one of {', '.join(PRESETS)}.")
    return PRESETS[name]
