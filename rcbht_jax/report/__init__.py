"""One self-contained HTML page about a store: results, counts, confounds, a browser of trials.

It shows what the store and files of result rows contain; it measures nothing and fetches nothing.
"""

from rcbht_jax.report.page import Options, page

__all__ = ["Options", "page"]
