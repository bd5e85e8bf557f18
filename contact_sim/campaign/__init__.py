"""Many flights: chance, faults, and what came of them."""
