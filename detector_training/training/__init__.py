"""How the net learns: crops, assignment, loss and the loop."""
