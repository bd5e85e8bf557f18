"""Do colour and depth camera agree? Circles against plane, over a recording."""
