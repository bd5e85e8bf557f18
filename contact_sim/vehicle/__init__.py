"""What makes the drone fly: estimator, velocity loop, rotors; and the wind that it flies in.

Plain floats in tuples: at 250 Hz a small numpy array costs more than all the algebra in it.
"""
