"""Pictures of faulty trials: a tab that is missing is not drawn, and names of short states are legible."""

from __future__ import annotations

import numpy as np
import pytest

from rcbht_jax.plots.canvas import new_figure
from rcbht_jax.types import Recordings
from sim_mjx.assembly.parts import TABS
from sim_mjx.engines import native
from sim_mjx.plots.projection import SIDE, Drawing
from sim_mjx.plots.trial_overview import shade_states
from sim_mjx.randomization.trials import DomainRandomization
from sim_mjx.registry import get_scenario


@pytest.mark.parametrize("preset", ["hooked-B", "B"])  # its tip is drawn back, or its lip is lowered
def test_a_missing_tab_is_not_drawn(preset: str) -> None:
    scenario = get_scenario(preset)
    scene = scenario.scene()
    params, fault = scenario.draw(0, 0, DomainRandomization(nominal_share=0.0, faults=("missing-tab",)))
    (tab,) = np.flatnonzero(params.parts.missing)
    assert fault.kind == "missing-tab"
    whole = native.model_of(scene, scenario.draw(0, 0, DomainRandomization(nominal_share=1.0))[0].parts)
    broken = native.model_of(scene, params.parts)
    shapes = {}
    for name, model, missing in (("whole", whole, ()), ("hidden", broken, (TABS[tab],)), ("shown", broken, ())):
        ax = new_figure((4.0, 4.0), 50).add_subplot()
        Drawing(ax, model, SIDE, missing=missing).show(model.qpos0, np.zeros(4, bool))
        shapes[name] = [path.get_extents() for path in ax.collections[0].get_paths()]
    assert len(shapes["shown"]) == len(shapes["whole"]) == len(shapes["hidden"]) + 2


def test_names_of_short_states_are_whole_and_apart() -> None:
    phases = ("approach", 0.0, 9.0), ("insertion", 9.0, 9.2), ("a long name", 9.2, 9.6), ("rest", 9.6, 10.0)
    marks = [(0, "phase", *phase) for phase in phases]
    recordings = Recordings.from_arrays(np.zeros((1, 2000, 6)), 200.0, annotations=marks)
    figure = new_figure((9.6, 7.2), 100)
    ax = figure.add_axes((0.08, 0.09, 0.89, 0.31))
    shade_states(ax, recordings, 0, names=True)
    ax.set(xlim=(0, 1999 / 200))
    figure.canvas.draw()
    panel, boxes = ax.get_window_extent(), [text.get_window_extent() for text in ax.texts]
    assert len(boxes) == 4
    assert all(panel.x0 <= box.x0 and box.x1 <= panel.x1 + 1 for box in boxes)
    assert not any(a.overlaps(b) for n, a in enumerate(boxes) for b in boxes[n + 1 :])
