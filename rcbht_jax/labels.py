"""The three alphabets of the taxonomy: the only place where a label's number, name or meaning is written.

Codes follow the authors' programs. 0 is never a label: it marks an empty slot in padded arrays.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
UNITS = ("N", "N", "N", "Nm", "Nm", "Nm")  # of AXES
UNIT_OF = dict(zip(AXES, UNITS, strict=True))
LAYERS = ("primitive", "mc", "llb")


class Primitive(IntEnum):
    """Gradient label of a straight-line segment (paper, section III-A)."""

    BPOS = 1
    MPOS = 2
    SPOS = 3
    BNEG = 4
    MNEG = 5
    SNEG = 6
    CONS = 7
    PIMP = 8
    NIMP = 9


class MC(IntEnum):
    """Motion composition: an ordered pair of primitives (paper, section III-B)."""

    A = 1
    I = 2
    D = 3
    K = 4
    PC = 5
    NC = 6
    C = 7
    U = 8


class LLB(IntEnum):
    """Low-level behaviour: an ordered pair of motion compositions (paper, section III-C)."""

    FX = 1
    CT = 2
    PS = 3
    PL = 4
    AL = 5
    SH = 6
    U = 7
    N = 8


class Group(IntEnum):
    """What a primitive contributes to a pair: its sign, constancy or impulse."""

    P = 0
    N = 1
    K = 2
    PIMP = 3
    NIMP = 4


ALPHABETS: tuple[type[IntEnum], type[IntEnum], type[IntEnum]] = (Primitive, MC, LLB)
LAYER_SIZES = (9, 8, 8)

MEANING = {
    "primitive": (
        "big positive", "medium positive", "small positive", "big negative", "medium negative",
        "small negative", "constant", "positive impulse", "negative impulse",
    ),
    "mc": (
        "adjustment", "increase", "decrease", "constant", "positive contact", "negative contact",
        "contact", "unstable",
    ),
    "llb": ("fixed", "contact", "push", "pull", "align", "shift", "unstable", "noise"),
}  # fmt: skip

# Warm = rising, blue = falling, grey = constant, dark = contact: readable as a band and in greyscale.
COLORS = {
    "primitive": (
        "#d94801", "#fd8d3c", "#fdd0a2", "#08519c", "#4292c6", "#c6dbef", "#bdbdbd", "#67000d", "#3f007d",
    ),
    "mc": ("#31a354", "#fd8d3c", "#4292c6", "#bdbdbd", "#67000d", "#3f007d", "#252525", "#e7298a"),
    "llb": ("#bdbdbd", "#252525", "#fd8d3c", "#4292c6", "#31a354", "#9e9ac8", "#e7298a", "#f0e442"),
}  # fmt: skip

# Index = primitive code; entry 0 is the empty slot.
PRIMITIVE_GROUP: NDArray[np.int32] = np.array([-1, 0, 0, 0, 1, 1, 1, 2, 3, 4], np.int32)

# Rows: first group, columns: second group (paper, section III-B).
MC_PAIR: NDArray[np.int32] = np.array(
    [
        [MC.I, MC.A, MC.I, MC.PC, MC.C],
        [MC.A, MC.D, MC.D, MC.C, MC.NC],
        [MC.I, MC.D, MC.K, MC.PC, MC.NC],
        [MC.C, MC.C, MC.PC, MC.U, MC.C],
        [MC.C, MC.C, MC.NC, MC.C, MC.U],
    ],
    np.int32,
)
MC_SINGLE: NDArray[np.int32] = np.array([MC.I, MC.D, MC.K, MC.PC, MC.NC], np.int32)


def name(layer: str, code: int) -> str:
    """Short lower-case name of a label, for example ``name("mc", 5) == "pc"``; ``"-"`` for the empty slot 0.

    Raises:
        ValueError: the layer or the code does not exist.
    """
    if layer not in LAYERS:
        raise ValueError(f"layer is {layer!r}; expected one of {', '.join(LAYERS)}.")
    if code == 0:
        return "-"
    label = ALPHABETS[LAYERS.index(layer)](code).name
    return label if layer == "llb" else label.lower()
