"""Assemblies by name: part pairs with their controllers, for any robot of ``sim_mjx.robots``."""

from __future__ import annotations

from rcbht_jax._util.optional import require

require("mujoco", "sim")

from sim_mjx.assemblies.assembly import Assembly, Phase, Variation  # noqa: E402
from sim_mjx.assemblies.clip import CLIP  # noqa: E402
from sim_mjx.assemblies.peg import ROUND, SQUARE  # noqa: E402
from sim_mjx.assemblies.plug import PLUG  # noqa: E402

__all__ = ["ASSEMBLIES", "Assembly", "Phase", "Variation"]
ASSEMBLIES = {assembly.name: assembly for assembly in (ROUND, SQUARE, CLIP, PLUG)}
