"""The meaning of names of columns: axes of a wrench, counters, labels, groups."""

from __future__ import annotations

import re
from collections.abc import Iterable

from rcbht_jax._util.columns import base_and_unit, split_unit
from rcbht_jax.labels import AXES

NANOSECONDS = ("nsec", "nsecs", "nanosec", "nanoseconds")
COUNTERS = (
    "index", "sample", "samples", "frame", "frame_index", "step", "row", "seq", "header.seq", "unnamed: 0",
    "field.header.seq", "task_index", "next.done",
)  # fmt: skip
GROUPS = (
    "instance", "episode", "recording", "series", "run", "demo", "sequence", "trial", "experiment", "traj",
    "trajectory",
)  # fmt: skip
WEAK_GROUPS = ("sample", "cycle", "file", "filename", "file_name", "id")  # if each value holds for many rows in a row
LABELS = (
    "label", "labels", "label_name", "state", "phase", "class", "skill", "primitive", "mode", "subtask", "stage",
    "sub_task", "segment", "annotation", "state_index", "action_label", "contact_state", "action", "anomaly",
    "category", "fault", "contact", "in_contact", "event", "activity",
)  # fmt: skip

FORCES, MOMENTS = ("N", "mN", "kN", "kgf", "lbf"), ("Nm", "mNm", "Nmm", "Ncm", "kNm", "lbf in", "lbf ft")
WHOLE = ("wrench", "force", "forces", "torque", "torques", "moment", "moments", "ft")  # of several axes in one column
_DEMANDED = {"desired", "target", "cmd", "command", "commanded", "ref", "reference", "goal", "setpoint", "next"}
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_TWICE = re.compile(r"(?<=torque)(\d*)_tau")  # cartTorque1_TauX
_AXIS = re.compile(
    r"^(|.*[._/ \-])(force|f|torque|moment|tau|t|m)(\d*)(?:_?ext)?[._/ \-]*([xyz])(?:[._/](?:data|values?))?$"
)
# in any language, where a unit tells the quantity
_WORD = re.compile(r"^(|.*[._/ \-])([^\W\d_]+)(\d*)[._/ \-]*([xyz])$")
_ELEMENT = re.compile(
    r"^(|.*[._/ \-])(wrench|force_torque|forcetorque|ft|ft_sensor|f_ext_hat_k|forces?|f|torques?|moments?|tau|t|m)"
    r"(?:[._/](?:signals[._/])?(?:data|values?))?(_|\[|\()(\d+)[\])]?$"
)
_SIX = ("wrench", "force_torque", "forcetorque", "ft", "ft_sensor", "f_ext_hat_k")


def wrenches(names: Iterable[str]) -> list[dict[str, str]]:
    """The wrenches that columns hold: axis (Fx ... Mz) -> column; the three forces, and the moments that are there.

    >>> wrenches(["a.force.x", "a.force.y", "a.force.z", "speed"])
    [{'Fx': 'a.force.x', 'Fy': 'a.force.y', 'Fz': 'a.force.z'}]
    >>> wrenches(["Kraft_x [N]", "Kraft_y [N]", "Kraft_z [N]"])
    [{'Fx': 'Kraft_x [N]', 'Fy': 'Kraft_y [N]', 'Fz': 'Kraft_z [N]'}]
    """
    found: dict[str, dict[str, str]] = {}
    rows: dict[tuple[str, str, str], dict[int, str]] = {}
    for name in names:
        base, unit = split_unit(name)
        base = _TWICE.sub(r"\1", snake(base))
        if match := _AXIS.match(base) or (_WORD.match(base) if unit in (*FORCES, *MOMENTS) else None):
            kind = "F" if unit in FORCES or match[2] in ("force", "f") else "M"
            axes = found.setdefault(match[1] + match[3], {})
            if match[2] in ("torque", "moment", "tau", "m"):  # then tx is a translation
                axes[kind + match[4]] = name
            axes.setdefault(kind + match[4], name)
        elif match := _ELEMENT.match(base):
            rows.setdefault((match[1], match[2], match[3]), {})[int(match[4])] = name
    for (prefix, kind, bracket), elements in rows.items():
        # F_1, F_2, ... may be sensors of one axis each
        first = min(elements) if bracket != "_" or kind in _SIX else 0
        numbers = {number - first: name for number, name in elements.items()}
        if first <= 1 and set(numbers) == set(range(6)) and not kind.startswith(("t", "m")):
            found.setdefault(f"{prefix}{kind}_", {}).update(zip(AXES, (numbers[n] for n in range(6)), strict=True))
        elif first <= 1 and set(numbers) == {0, 1, 2} and kind not in _SIX:
            letter = "F" if kind.startswith("f") else "M"
            for number, axis in enumerate("xyz"):
                found.setdefault(prefix, {}).setdefault(letter + axis, numbers[number])
    complete = []
    for axes in found.values():
        if {"Fx", "Fy", "Fz"} <= set(axes):
            complete.append({axis: axes[axis] for axis in AXES if axis in axes})
    return complete


def is_demanded(name: str) -> bool:
    """Whether a column is what was wanted by its name, or a copy of the next sample, and not what was measured.

    >>> is_demanded("desired_wrench_0"), is_demanded("wrench_0")
    (True, False)
    """
    return bool(_DEMANDED & set(re.split(r"[\W_]+", snake(name))))


def snake(name: str) -> str:
    """A name in lower case, with a "_" between words that only a capital separates.

    >>> snake("ZeitInSec"), snake("tcpForce.X")
    ('zeit_in_sec', 'tcp_force.x')
    """
    return _CAMEL.sub("_", name).lower()


def group_base(name: str) -> str:
    """The lower-case name of a column that may number recordings, without a suffix such as "_id" or "_nr".

    >>> group_base("Trial_ID"), group_base("sample_nr")
    ('trial', 'sample')
    """
    return re.sub(r"[ _.]?(id|nr|no|num|number|index|idx)$", "", base_and_unit(name)[0])


def column_name(text: str) -> str:
    """A name that a store accepts for a column, as near as possible to the text.

    >>> column_name("type of part (A/B)")
    'type_of_part_A_B'
    """
    name = re.sub(r"[^\w.-]+", "_", text).strip("_.-")
    return name if re.match(r"[^\W\d]", name) else f"c_{name}"
