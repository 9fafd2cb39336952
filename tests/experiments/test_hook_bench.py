"""A tab on the bench: forces as the formulas say, a spring that comes back, and faults that are geometry."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import mujoco
import numpy as np
import pytest

from experiments.simulation.hook_bench import press_and_pull
from rcbht_jax.errors import InputError
from sim_mjx.assembly import hook as hooks
from sim_mjx.assembly.hook import Hook, beam_stiffness, broken, lip_boxes, mating_force, separation_force, strain, worn

TAB = Hook(8540.0, 0.8e-3, np.radians(35), np.radians(55), friction=0.3)


GRID = tuple(product((25, 35, 45), (0.2, 0.3, 0.4), (5e-4, 7.5e-4, 1e-3)))


@pytest.mark.parametrize(("angle", "friction", "overlap"), GRID)
def test_forces_are_those_of_the_formula(angle: float, friction: float, overlap: float) -> None:
    hook = Hook(TAB.stiffness, overlap, np.radians(angle), np.radians(min(90 - angle, 55)), friction)
    pressed, pulled = press_and_pull([hook])
    np.testing.assert_allclose(pressed.peak, mating_force(hook), rtol=0.05)
    np.testing.assert_allclose(pulled.peak, separation_force(hook), rtol=0.05)
    assert np.abs(pressed.deflection[-1]).max() < 1e-6  # it springs back whole
    np.testing.assert_allclose(pressed.deflection.max(), overlap, rtol=0.1)


def test_the_formula_of_a_sharp_tip_is_that_of_design_guides() -> None:
    sharp = replace(TAB, tip_radius=1e-9)
    slope = np.tan(TAB.lead_angle)
    assert mating_force(sharp) == pytest.approx(8540 * 0.8e-3 * (0.3 + slope) / (1 - 0.3 * slope))
    # a cantilever of ABS under 10 N: deflection F L^3 / (3 E I), strain M h / (2 E I) at its root
    width, thickness, length, modulus = 6e-3, 2e-3, 14e-3, 2.3e9
    inertia = width * thickness**3 / 12
    deflection = 10 * length**3 / (3 * modulus * inertia)
    assert beam_stiffness(modulus, width, thickness, length) == pytest.approx(10 / deflection)
    assert strain(deflection, thickness, length) == pytest.approx(10 * length * thickness / 2 / (modulus * inertia))


def test_a_smooth_hook_gives_back_the_work_that_bent_it() -> None:
    """Without friction force times travel is the energy of the spring, up and down again."""
    pressed, _ = press_and_pull([replace(TAB, friction=1e-6)], step=2.5e-4)
    work = np.concatenate([[0.0], np.cumsum(pressed.force[:-1] * np.diff(pressed.travel))])
    np.testing.assert_allclose(work.max(), TAB.stiffness * TAB.overlap**2 / 2, rtol=0.07)


def test_a_steep_hook_holds_what_no_hand_pulls() -> None:
    for angle in (80, 85):
        hook = replace(TAB, retention_angle=np.radians(angle), edge=0.2e-3)
        pressed, pulled = press_and_pull([hook])
        assert separation_force(hook) == np.inf
        assert pulled.peak > 100 > pressed.peak
        np.testing.assert_allclose(pressed.peak, mating_force(hook), rtol=0.05)


def test_tabs_add_when_they_pass_together() -> None:
    alone, together = press_and_pull([TAB]), press_and_pull([TAB] * 4)
    for one, four in zip(alone, together, strict=True):
        np.testing.assert_allclose(four.peak, 4 * one.peak, rtol=0.02)
    after = press_and_pull([TAB] * 4, [0, 0, 6e-3, 6e-3])[0]
    np.testing.assert_allclose(after.peak, 2 * alone[0].peak, rtol=0.02)


def test_wear_and_breakage_are_geometry() -> None:
    new, old, gone = (press_and_pull([one])[0] for one in (TAB, worn(TAB, 0.3e-3), broken(TAB)))
    assert gone.peak < 0.01 < old.peak < 0.6 * new.peak
    np.testing.assert_allclose(old.peak, mating_force(worn(TAB, 0.3e-3)), rtol=0.05)
    assert np.abs(gone.deflection).max() < 1e-9
    slope = np.tan(np.radians(35))
    bent = 0.5e-3 - 0.7e-3 * (1 - np.cos(np.radians(35)))  # m, by a tip of 0.7 mm that reaches 0.5 mm under the lip
    assert mating_force(worn(TAB, 0.3e-3)) == pytest.approx(8540 * bent * (0.3 + slope) / (1 - 0.3 * slope))
    assert mating_force(broken(TAB)) == separation_force(broken(TAB)) == 0.0
    steep = replace(TAB, retention_angle=np.radians(80), edge=0.2e-3)  # friction alone holds it
    rounded = worn(steep, steep.overlap - 0.05e-3)
    assert separation_force(steep) == np.inf
    assert separation_force(broken(steep)) == separation_force(rounded) == 0.0


def test_a_tab_that_is_let_go_comes_back_fast_and_does_not_ring() -> None:
    """A critically damped spring: x = x0 (1 + w t) exp(-w t), without a change of sign."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = 1e-5, (0.0, 0.0, 0.0)
    hooks.add_tab(spec.worldbody.add_body(), "0", TAB, np.zeros(3))
    model = spec.compile()
    data, rate = mujoco.MjData(model), np.sqrt(TAB.stiffness / hooks.ARMATURE)
    data.qpos[0] = 1e-3
    mujoco.mj_step(model, data, 1000)
    phase = rate * data.time
    assert data.qpos[0] == pytest.approx(1e-3 * (1 + phase) * np.exp(-phase), abs=1e-5)


def test_the_bench_notices_a_wrong_lip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hooks, "lip_boxes", lambda hook: lip_boxes(replace(hook, lead_angle=hook.lead_angle - 0.15)))
    assert abs(press_and_pull([TAB])[0].peak / mating_force(TAB) - 1) > 0.1


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"stiffness": -1.0}, "stiffness is -1.0"),
        ({"stiffness": 0.0}, "stiffness is 0.0"),
        ({"friction": np.nan}, "friction is nan"),
        ({"lead_angle": 35.0}, "radians"),
        ({"retention_angle": np.pi / 2}, "edge is 0.1 mm; .* need 0.2 mm"),
    ],
)
def test_impossible_hooks_are_refused(values: dict[str, float], said: str) -> None:
    with pytest.raises(InputError, match=said):
        replace(TAB, **values)
