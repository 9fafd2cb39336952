"""The words that a picture shows: those of the fit rule, unless another rule is chosen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from rcbht_jax.cli.command import option

if TYPE_CHECKING:
    from rcbht_jax.encoding.rules import AnyLimits
    from rcbht_jax.types import LabelTracks

DrawnRule = Annotated[
    Literal["fit", "paper"],
    option(
        "Rule of the words shown if --tracks names none: fit, whose words follow the signal, or paper. Words that are "
        "not in the store are computed."
    ),
]
SAYS = {"fit": "words by the fit rule", "paper": "words by the published rules"}


def rule_of(attrs: dict[str, Any]) -> str:
    """The rule of label tracks, by what they note; that of the authors' program is the paper's.

    >>> rule_of({"config": {"rule": "fit"}}), rule_of({"semantics": "offline"})
    ('fit', 'paper')
    """
    return "fit" if attrs.get("config", {}).get("rule") == "fit" else "paper"


def stored_by(store: Path, rule: str) -> str:
    """Name of the label tracks by a rule; "" = the store has only others."""
    from rcbht_jax.errors import InputError
    from rcbht_jax.io.label_store import choose_name, list_tracks, read_tracks_attrs

    names = list_tracks(store)
    if not names:
        choose_name(store)
    found = [name for name in names if rule_of(read_tracks_attrs(store, name)) == rule]
    if len(found) > 1:
        raise InputError(f"{store} has several label tracks; choose one with --tracks: {', '.join(found)}.")
    return found[0] if found else ""


def thresholds_now(store: Path, window: int | None, rule: Literal["fit", "paper"]) -> AnyLimits | None:
    """Gradient thresholds of labels that are made now, as ``rcbht encode`` chooses them; None = none are made."""
    from rcbht_jax.cli.encode import Encode
    from rcbht_jax.io.store import read_sample

    if window is None:
        return None
    return Encode(store, window=window, rule=rule).read_limits(read_sample(store)[0], store)[0]


def made_now_note(store: Path, name: str) -> str:
    """What to say after the name of words that were made for a picture, while the store holds others; "" = nothing."""
    from rcbht_jax.io.label_store import list_tracks

    stored = list_tracks(store)
    return "" if not stored or name in stored else f" made now (--tracks shows those of the store: {', '.join(stored)})"


def drawn_words(store: Path, tracks: str, rule: Literal["fit", "paper"]) -> tuple[str, LabelTracks, dict[str, Any]]:
    """Name, labels and attributes of what is drawn: tracks by name, stored ones by the rule, or words made now."""
    from rcbht_jax.cli.encode import Encode
    from rcbht_jax.io.label_store import choose_tracks

    if tracks or (name := stored_by(store, rule)):
        return choose_tracks(store, tracks or name)
    return Encode(store, rule=rule).made_now()
