"""The meaning of names of columns: axes of a wrench, counters, labels, groups."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import pairwise

from rcbht_jax._util.columns import FORCES, MOMENTS, TIMES, base_and_unit, is_moment, snake, split_unit
from rcbht_jax.io.checks import LONGEST_NAME, RESERVED
from rcbht_jax.labels import AXES

NANOSECONDS = ("nsec", "nsecs", "nanosec", "nanoseconds")
COUNTERS = (
    "index", "sample", "samples", "frame", "frame_index", "step", "row", "seq", "header.seq", "unnamed: 0",
    "field.header.seq", "task_index", "next.done", "__index_level_0__",
)  # fmt: skip
ENDS = ("is_first", "is_last", "is_terminal", "terminated", "truncated", "done", "dones")  # flags of learning data sets
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

TOPICS = ("topic", "topic_name")  # of the messages of a log, which are no labels

OF_FORCES = ("wrench", "force", "forces", "ft")
WHOLE = (*OF_FORCES, "torque", "torques", "moment", "moments")  # of several axes in one column
_DEMANDED = {
    "desired", "des", "target", "cmd", "command", "commanded", "ref", "reference", "goal", "setpoint", "next", "err",
    "error", "dot", "std", "var", "bias",
}  # fmt: skip
_RAW, _COMPENSATED = {"raw", "uncompensated"}, {"compensated", "comp", "tared"}
_QUALIFIERS = (
    "continuous|raw|filtered|compensated|comp|measured|meas|ext|external|data|values?|sensor|tcp|tool|ee|base|world|"
    "cartesian|"
    "history|calibrated|tared|est|estimated|left|right|l|r"
)
_WORD_IN_BRACKETS = re.compile(r"^(.*\S)\s*(?!\{arm\})[\[({]\s*([^\W\d][^\])}]*)[\])}]$")
_FRAMES = r"tcp|tool|flange|ee|eef|base|world|sensor|left|right|\{arm\}"  # between a force and its axis: F_TCP_x
_FIRST_ARM = re.compile(r"\{arm\}(?=[^\W_])")  # {arm}Fx
_LAST_ARM = re.compile(r"(?:[\s\[(]+|(?<=[^\W_]))\{arm\}[\s\])]*$")  # Fx{arm}, Fx [{arm}]
_ARM = re.compile(r"\{arm\}[)\]}]?[ ._\-/]*")
SIDES = (("left", "right"), ("l", "r"))  # of arms
# of parts of a path: /'FT'/'Fx', levels: ('FT', 'Fx'), variables: $FT.Fx
_QUOTES = re.compile(r"""["'`,]|^\$|^\(|\)$""")
_SAID = re.compile(r"(?:force|torque|moment)s?(\d*)[._/ \-]*$")  # before an axis: Force Fx, cartTorque1_TauX
_AXIS = re.compile(
    r"^(|.*[._/ \-])(force|f|torque|moment|tau|t|m)(\d*)(?:_?ext)?((?:[._/ \-](?:" + _FRAMES + r"))?)"
    r"[._/ \-]*([xyz])(?:[._/](?:data|values?))?"
    r"((?:[._/ \-][\w{}]+)?)$"
)
# in any language, where a unit names the quantity
_WORD = re.compile(r"^(|.*[._/ \-])([^\W\d_]+)(\d*)()[._/ \-]*([xyz])()$")
_AXIS_FIRST = re.compile(r"^(|.*[._/ \-])([xyz])[._/ \-]*([^\W\d_]+)((?:[._/ \-][\w{}]+)?)$")  # x_force
_ELEMENT = re.compile(
    r"^(|.*?[._/ \-])(wrench|force_torque|forcetorque|ft|ft_sensor|f_ext_hat_k|forces?|f|torques?|moments?|tau|t|m)"
    r"((?:_(?:" + _QUALIFIERS + r"|\{arm\}))*(?:_\d+(?=_\d+$))?)"
    r"(?:[._/](?:signals[._/])?(?:data|values?|variables))?(_|\[|\(|)(\d+)[\])]?$"
)
_SIX = ("wrench", "force_torque", "forcetorque", "ft", "ft_sensor", "f_ext_hat_k")


def wrenches(names: Iterable[str]) -> list[dict[str, str]]:
    """The wrenches that columns hold: axis (Fx ... Mz) -> column; the three forces, and the moments that are there.

    >>> wrenches(["a.force.x", "a.force.y", "a.force.z", "speed"])
    [{'Fx': 'a.force.x', 'Fy': 'a.force.y', 'Fz': 'a.force.z'}]
    >>> wrenches(["Kraft_x [N]", "Kraft_y [N]", "Kraft_z [N]"])
    [{'Fx': 'Kraft_x [N]', 'Fy': 'Kraft_y [N]', 'Fz': 'Kraft_z [N]'}]
    >>> wrenches(["x_force", "y_force", "z_force"])
    [{'Fx': 'x_force', 'Fy': 'y_force', 'Fz': 'z_force'}]
    """
    found: dict[tuple[str, str], dict[str, str]] = {}  # by what stands before and after an axis
    rows: dict[tuple[str, str, str, str], dict[int, str]] = {}
    spelled = {
        name: (_QUOTES.sub("", snake(_FIRST_ARM.sub("{arm}_", _LAST_ARM.sub("_{arm}", base)))), unit)
        for name, (base, unit) in _parsed(names).items()
    }
    following = dict(pairwise([base for base, _ in spelled.values()] + [""]))
    for name, (base, unit) in spelled.items():
        if not unit and _is_no_moment(base, following):
            continue
        if part := _axis_of(base, unit):
            place, kind, letter, certain = part
            axes = found.setdefault(place, {})
            if certain:
                axes[kind + letter] = name
            axes.setdefault(kind + letter, name)
        elif (match := _ELEMENT.match(base)) and (match[2] in _SIX or (match[4] and not match[3][-1:].isdigit())):
            # F1, F2, ... may be of one axis each, F_0_0, F_0_1, ... those of a grid
            rows.setdefault((match[1], match[2], match[3], match[4]), {})[int(match[5])] = name
    for (prefix, kind, qualifiers, bracket), elements in rows.items():
        # F_1, F_2, ... may be sensors of one axis each
        first = min(elements) if bracket != "_" or kind in _SIX else 0
        numbers = {number - first: name for number, name in elements.items()}
        if first <= 1 and set(numbers) == set(range(6)) and not kind.startswith(("t", "m")):
            axes = found.setdefault((f"{prefix}{kind}_{qualifiers}", ""), {})
            axes.update(zip(AXES, (numbers[n] for n in range(6)), strict=True))
        elif first <= 1 and set(numbers) == {0, 1, 2} and kind not in _SIX:
            letter = "F" if kind.startswith("f") else "M"
            for number, axis in enumerate("xyz"):
                found.setdefault((prefix + qualifiers, ""), {}).setdefault(letter + axis, numbers[number])
    plain_first = sorted(found.items(), key=lambda item: item[0][1] != "")  # Fx before Fx_tool
    complete = (axes for _, axes in plain_first if {"Fx", "Fy", "Fz"} <= set(axes))
    return [{axis: axes[axis] for axis in AXES if axis in axes} for axes in complete]


def _parsed(names: Iterable[str]) -> dict[str, tuple[str, str]]:
    """The names without units, also without others in brackets, unless only these tell columns apart; and the units.

    >>> _parsed(["Fx (kp)"]), _parsed(["Fz (raw)", "Fz (low pass)"])
    ({'Fx (kp)': ('Fx', '')}, {'Fz (raw)': ('Fz_raw', ''), 'Fz (low pass)': ('Fz_low_pass', '')})
    """
    found = {name: split_unit(name) for name in names}
    words = {name: match for name, (base, _) in found.items() if (match := _WORD_IN_BRACKETS.match(base))}
    counts = Counter(words[name][1] if name in words else base for name, (base, _) in found.items())
    for name, match in words.items():
        tail = "" if counts[match[1]] == 1 else "_" + re.sub(r"\W+", "_", match[2]).strip("_")
        found[name] = match[1] + tail, ""
    return found


def _is_no_moment(base: str, following: Mapping[str, str]) -> bool:
    """Whether tx, ty, tz are those of a pose, before rx or qx and without x, or mx, my, mz of a magnetometer, after gz.

    >>> pose, both = {"tz": "rx", "rx": ""}, {"pz": "rx", "tz": ""}  # the next column of each
    >>> _is_no_moment("tx", pose), _is_no_moment("tx", both), _is_no_moment("my", {"gz": "mx"})
    (True, False, True)
    """
    match = re.fullmatch(r"(.*?)([tm])[xyz]", base)
    if not match:
        return False
    before = match[1]
    if match[2] == "m":
        return f"{before}mx" in (following.get(f"{before}gz"), following.get(f"{before}az"))
    turned = following.get(f"{before}tz") in (f"{before}rx", f"{before}qx")
    return turned and f"{before}x" not in following and f"{before}px" not in following


def _axis_of(base: str, unit: str) -> tuple[tuple[str, str], str, str, bool] | None:
    """What stands before and after an axis, F or M, x, y or z, and whether a T cannot be a translation; None = no axis.

    >>> _axis_of("left.torque_x", "")
    (('left.', ''), 'M', 'x', True)
    """
    known = unit in (*FORCES, *MOMENTS)
    last, first = _AXIS.match(base) or (_WORD.match(base) if known else None), _AXIS_FIRST.match(base)
    if last:
        before, word, number, frame, letter, after = last.groups()
    elif first and (known or first[3] in ("force", "torque", "moment")):
        before, letter, word, after, number, frame = *first.groups(), "", ""
    else:
        return None
    if after[1:] in (*TIMES, *NANOSECONDS) or unit in ("m", "mm"):  # of its samples, a translation
        return None
    kind = "M" if is_moment(f"{word}{letter}", unit) else "F"
    place = _SAID.sub(r"\1", f"{before}{number}"), f"{frame}{after}"
    return place, kind, letter, word in ("torque", "moment", "tau", "m")


def _words(name: str) -> list[str]:
    return re.split(r"[\W_\d]+", snake(name))


def has_forces(name: str) -> bool:
    """Whether a name is one of forces.

    >>> has_forces("ft_wrench"), has_forces("object_pose")
    (True, False)
    """
    return not set(OF_FORCES).isdisjoint(_words(name))


def has_axes(name: str, count: int) -> bool:
    """Whether so many elements of an array of that name may be the axes of forces, of torques or of both.

    >>> has_axes("tcp_force", 3), has_axes("torque", 200), has_axes("joints", 6)
    (True, False, False)
    """
    return count in (3, 6) and not set(WHOLE).isdisjoint(_words(name))


def mark_of(arm: str) -> re.Pattern[str]:
    """Finds an arm as a word of a name, also one that only a capital separates from others.

    >>> [bool(mark_of("left").search(name)) for name in ("arm_left", "ftLeft", "leftover")]
    [True, True, False]
    """
    return re.compile(rf"(?:(?<![A-Za-z])|(?<=[a-z])(?=[A-Z]))(?i:{re.escape(arm)})(?![a-z])(?!(?<=\d)\d)")


def names_side(name: str) -> bool:
    """Whether a name holds the word left or right, as that of an arm's group does.

    >>> names_side("arm_left"), names_side("Right"), names_side("upright")
    (True, True, False)
    """
    return any(mark_of(side).search(name) for side in SIDES[0])


def axis_name(name: str) -> str:
    """The axis that a column is by a name without anything else; "" = none, or a T that may be a translation.

    >>> axis_name("mx [Nm]"), axis_name("force_z"), axis_name("left_fx"), axis_name("tx"), axis_name("tx [Nm]")
    ('Mx', 'Fz', '', '', 'Mx')
    """
    base, unit = split_unit(name)
    place, kind, letter, certain = _axis_of(snake(base), unit) or (("", ""), "", "", False)
    return kind + letter if place == ("", "") and (certain or kind == "F" or unit in MOMENTS) else ""


def preference(name: str) -> int:
    """How much a wrench is worth, by the name of a column: what is compensated most, then raw, what is demanded least.

    >>> [preference(name) for name in ("ft_compensated/force_x", "Fx", "Fx_raw", "desired_wrench_0")]
    [3, 2, 1, 0]
    """
    words = set(re.split(r"[\W_]+", snake(name)))
    return 0 if words & _DEMANDED else 1 if words & _RAW else 3 if words & _COMPENSATED else 2


def preferred(found: Iterable[dict[str, str]]) -> dict[str, str]:
    """The wrench of several that an import takes: by the names of its columns, then that of the most axes; {} = none.

    >>> preferred(wrenches(f"{what}_{axis}" for what in ("desired_force", "force") for axis in "xyz"))["Fx"]
    'force_x'
    """
    return max(found, key=lambda wrench: (preference(wrench["Fx"]), len(wrench)), default={})


def group_base(name: str) -> str:
    """The lower-case name of a column that may number recordings, without a suffix such as "_id" or "_nr".

    >>> group_base("Trial_ID"), group_base("sample_nr")
    ('trial', 'sample')
    """
    return re.sub(r"[ _.]?(id|nr|no|num|number|index|idx)$", "", base_and_unit(name)[0])


def of_any_arm(name: str) -> str:
    """The name of a column without the place of its arm.

    >>> [of_any_arm(name) for name in ("{arm}_phase", "robot/{arm}/phase", "phase ({arm})", "phase")]
    ['phase', 'robot/phase', 'phase', 'phase']
    """
    bare = _ARM.sub("", name)
    return name if bare == name else bare.strip(" ._-/([{")


def column_name(text: str) -> str:
    """A name that a store accepts for a column, as near as possible to the text.

    >>> column_name("type of part (A/B)")
    'type_of_part_A_B'
    """
    name = re.sub(r"[^\w.-]+", "_", text).strip("_.-")
    name = name if re.match(r"[^\W\d]", name) and name not in RESERVED else f"c_{name}"
    if len(name.encode()) <= LONGEST_NAME:
        return name
    mark = hashlib.sha256(name.encode()).hexdigest()[:8]  # keeps apart what begins alike
    return f"{name.encode()[: LONGEST_NAME - 9].decode(errors='ignore')}_{mark}"
