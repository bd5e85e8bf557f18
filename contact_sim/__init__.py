"""A drone in a world of MuJoCo, flown by the real client through the real service."""
