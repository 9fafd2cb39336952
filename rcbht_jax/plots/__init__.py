"""Figures of recordings and their labels, as matplotlib objects without any global state.

``pyplot`` and ``rcParams`` are not used: figures can be made in threads and servers.
"""

from rcbht_jax._util.optional import needs_extra

with needs_extra("report"):
    from rcbht_jax.plots.canvas import save
    from rcbht_jax.plots.label_map import label_map
    from rcbht_jax.plots.trial import trial_figure

__all__ = ["label_map", "save", "trial_figure"]
