"""The target's geometry and its localiser: pure numpy + OpenCV, for the service and the drone."""
