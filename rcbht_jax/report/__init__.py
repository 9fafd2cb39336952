"""One self-contained HTML page about a store: results read from JSON, counts, confounds, a browser of trials.

Nothing is computed here that a result file or the store does not say, and the page fetches nothing.
"""

from rcbht_jax.report.page import Options, page

__all__ = ["Options", "page"]
