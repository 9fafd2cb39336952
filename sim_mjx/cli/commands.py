"""The commands of this package, found by the entry point ``sim`` of the group ``rcbht.commands``."""

# Words of the command -> (module:class, summary), as in rcbht_jax.cli.commands.
COMMANDS: dict[str, tuple[str, str]] = {
    "simulate": ("sim_mjx.cli.simulate:Simulate", "simulate randomised trials of an assembly into a store"),
    "doctor": ("sim_mjx.cli.doctor:Doctor", "check this machine, or a store and what made it"),
    "view": ("sim_mjx.cli.view:View", "show one trial: interactively, as pictures or as a film"),
    "fidelity": ("sim_mjx.cli.fidelity:Fidelity", "compare the simulation with a finer solver, engines and recordings"),
    "fidelity fit": ("sim_mjx.cli.fidelity_fit:FidelityFit", "fit physical parameters to a recorded session"),
    "demo": ("sim_mjx.cli.demo:Demo", "run the whole chain on simulated or recorded trials"),
}
