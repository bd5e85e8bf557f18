"""What was found in a picture, drawn for people: pure functions from values to pixels."""
