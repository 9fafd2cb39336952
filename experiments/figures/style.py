"""Style of all figures of results."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes

IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
DPI = 110
# Colours that are distinct for any colour vision (Okabe and Ito).
OURS, PEER, PROBE = "#0072B2", "#E69F00", "#999999"
LINES = ("#D55E00", "#0072B2", "#999999", "#009E73")


def plain(ax: Axes) -> None:
    """An axis without a frame above and on its right."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(labelsize=8)
