"""The commands of this package; a package adds its own by an entry point of the group ``rcbht.commands``."""

# Words of the command -> (module:class, summary). A module is imported only when its command is called.
COMMANDS: dict[str, tuple[str, str]] = {
    "import hiro": ("rcbht_jax.cli.store:ImportHiro", "read recorded trials of the HIRO robot into a store"),
    "import": ("rcbht_jax.cli.importing:Import", "read files of any robot (CSV, bags, HDF5, ...) into a store"),
    "info": ("rcbht_jax.cli.store:Info", "summarise and verify a store"),
    "encode": ("rcbht_jax.cli.encode:Encode", "encode every recording of a store as labels"),
    "calibrate": ("rcbht_jax.cli.calibrate:Calibrate", "find gradient thresholds from recorded trials"),
    "evaluate": ("rcbht_jax.cli.learning:Evaluate", "cross-validate a classifier of the labels, with baselines"),
    "train": ("rcbht_jax.cli.learning:Train", "train a classifier of the labels and write a model file"),
    "classify": ("rcbht_jax.cli.learning:Classify", "classify every sentence of a store with a trained model"),
    "train-online": ("rcbht_jax.cli.stream:TrainOnline", "train a model that computes beliefs from a stream"),
    "stream": ("rcbht_jax.cli.stream:Stream", "compute beliefs and events from a stream, as JSON lines"),
    "serve": ("rcbht_jax.cli.stream:Serve", "show a stream, its labels and beliefs on a live web page"),
    "export-model": ("rcbht_jax.cli.stream:ExportModel", "write the whole chain of a model as StableHLO"),
    "export": ("rcbht_jax.cli.export:Export", "write a store as Parquet, LeRobot, MCAP or CSV"),
    "report": ("rcbht_jax.cli.export:Report", "write one HTML page: results, trials, labels and beliefs"),
    "plot trial": ("rcbht_jax.cli.plot:PlotTrial", "plot one trial with its labels"),
    "plot beliefs": ("rcbht_jax.cli.plot:PlotBeliefs", "plot the beliefs of a model over one trial"),
    "plot map": ("rcbht_jax.cli.plot:PlotMap", "plot the labels of all recordings of a store"),
    "bench": ("rcbht_jax.cli.bench:Bench", "measure speed and memory of the encoders"),
    "completion": ("rcbht_jax.cli.completion:Completion", "print the completion script for a shell"),
}
