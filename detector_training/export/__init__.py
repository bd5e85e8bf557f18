"""From weights to files for other runtimes, each checked against the net that it came from."""
