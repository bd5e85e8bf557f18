"""The detector: an anchor-free net with one box per class, its engine and the weights."""
