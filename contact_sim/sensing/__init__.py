"""The sensors of the simulated drone."""
