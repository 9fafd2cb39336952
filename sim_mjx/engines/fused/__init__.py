"""The engine fused: our own physics in one Warp kernel, with a thread for each trial, launched each control period."""
