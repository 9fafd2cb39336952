"""From simulated to recorded trials by words of the fit rule alone, where neither A nor B was simulated.

The protocol, sets, families ("words") and grid are those of the row "features, without A and B | words" of
experiments.classification.sim_to_real, which is made again beside them. Words of the fit rule count as they are, or
weigh by time and change of value; their tolerance is learned from simulated training trials, without labels, or is a
quarter of that; the last row has encoders of three tolerances side by side.

Run: python -m experiments.classification.sim_to_real_fit FOLDER
FOLDER holds the sets of ``experiments.classification.sim_to_real_sets``; missing ones are made.
Reads the recorded trials (RCBHT_DATA).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import tyro

from experiments._lib.checkpointed_rows import ALL_ROWS, Only, Rows
from experiments._lib.fit_words import FIT_RULE, THREE, WINDOW, WORDS
from experiments.classification.sim_to_real import SEED, Experiment
from experiments.classification.sim_to_real_rows import ROWS

PROTOCOL = "features, without A and B | words"
FIT = {
    name: replace(ROWS[PROTOCOL], rule=words.rule, weighing=words.weighing, factors=(words.factor,), window=WINDOW)
    for name, words in WORDS.items()
}
FIT["fit, three tolerances"] = replace(FIT["fit"], factors=THREE)


def main(folder: tyro.conf.Positional[Path], only: Only = ALL_ROWS) -> None:
    experiment = Experiment(folder)
    about = {
        "what": "states of recorded trials by words alone, of learners that saw simulated trials of C and OpenHRP only",
        "protocol": PROTOCOL,
        "choices": "families, weighing and single factors on the tolerance were fixed before the first score of a fit "
        "row; two and three tolerances side by side were tried after all others, also weighed",
        "fit rule": FIT_RULE,
        "tolerance": {name: experiment.tolerances(spec) for name, spec in FIT.items() if spec.rule == "fit"},
    }
    rows = Rows("fit_sim_to_real", "python -m experiments.classification.sim_to_real_fit FOLDER", about, SEED)
    rows.fill({name: experiment.row(spec) for name, spec in FIT.items()}, only)


if __name__ == "__main__":
    tyro.cli(main, description=__doc__)
