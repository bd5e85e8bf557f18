"""The HTTP side: health, metrics, what the model is, and the pose of a target in one picture."""
