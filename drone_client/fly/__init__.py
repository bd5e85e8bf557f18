"""``drone-client fly``: from a camera to a gentle contact, with a person in charge."""
