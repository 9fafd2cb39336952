"""Scores of committed results, as tables and pictures of the report take them."""

from __future__ import annotations

from experiments._lib.scores import RICHER, TABLE1, by_benchmark, of_peers, of_probes, of_table1, of_two_arms


def test_names_of_rows_are_a_benchmark_and_a_method() -> None:
    rows = {"outcome | words": 1, "states | words": 2, "outcome | forest": 3}
    assert by_benchmark(rows) == {"outcome": {"words": 1, "forest": 3}, "states": {"words": 2}}


def test_rows_of_the_grammar_stand_as_ours_beside_the_peers() -> None:
    grammar = {f"outcome | {method}": {"score": k} for k, method in enumerate(RICHER)} | {"outcome | other": {}}
    found = of_peers({"rows": {"outcome | forest": {"kind": "peer"}}}, {"rows": grammar})
    ours = {title: {"kind": "ours", "score": k} for k, title in enumerate(RICHER.values())}
    assert found == {"outcome": {"forest": {"kind": "peer"}, **ours}}


def test_probes_show_balanced_accuracies_without_the_majority() -> None:
    rows = {f"load | {view}": {"balanced_accuracy": k, "accuracy": 9} for k, view in enumerate(("words", "majority"))}
    assert of_probes({"rows": rows}) == {"load": {"words": 0}}


def test_table_1_shows_accuracies_of_its_methods() -> None:
    row = {kind: {"accuracy": k, "balanced_accuracy": 9} for k, kind in enumerate((*TABLE1, "other"))}
    assert of_table1({"rows": {"outcome": row}}) == {"outcome": {kind: k for k, kind in enumerate(TABLE1)}}


def test_between_two_sets_the_trials_are_those_of_the_tested_one() -> None:
    words = {"mean": 0.5}
    result = {
        "measure": "accuracy",
        "recorded, cross-validated": {"words": words, "trials": 13},
        "two, cross-validated": {"words": words, "trials": 40},
        "trained on two, tested on recorded": {"words": words, "trials": 53},
    }
    assert of_two_arms(result) == {
        "recorded, cross-validated": (13, {"words": words}),
        "two, cross-validated": (40, {"words": words}),
        "trained on two, tested on recorded": (13, {"words": words}),
    }
    assert result["recorded, cross-validated"] == {"words": words, "trials": 13}  # stays as it was
