"""A flight without a clock: client, link and world take turns, and a seed gives one trajectory."""
