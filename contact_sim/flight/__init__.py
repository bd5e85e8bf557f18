"""Flying in a simulated world: what the client is given in place of camera, VIO and autopilot."""
