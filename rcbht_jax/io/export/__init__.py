"""Export of a store as Parquet, LeRobotDataset v3, MCAP or CSV: a folder with a data card.

Parquet and LeRobot need the extra ``export`` (pyarrow, pandas). Values, names, NaN and labels are written as they are
in the store; nothing is resampled, filtered or rotated.
"""

from rcbht_jax.io.export.dataset import Block, DataSet, load
from rcbht_jax.io.export.write import FORMATS, export

__all__ = ["FORMATS", "Block", "DataSet", "export", "load"]
