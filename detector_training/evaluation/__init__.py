"""How good a detector is: matching, scores with their intervals, pictures of what failed."""
