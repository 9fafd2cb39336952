"""Assemblies by name: part pairs with their controllers, for any robot of ``sim_mjx.robots``."""

from __future__ import annotations

from sim_mjx.assemblies.assembly import Assembly, Phase, Variation
from sim_mjx.assemblies.clip import CLIP
from sim_mjx.assemblies.peg import ROUND, SQUARE
from sim_mjx.assemblies.plug import PLUG

__all__ = ["ASSEMBLIES", "Assembly", "Phase", "Variation"]
ASSEMBLIES = {assembly.name: assembly for assembly in (ROUND, SQUARE, CLIP, PLUG)}
