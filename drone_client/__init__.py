"""The onboard client: source -> encode -> link; gate -> target -> guidance -> cbf -> autopilot."""
