"""Hardware in the loop, without hardware: an autopilot outside flies the simulated drone.

Speaks what PX4's SITL binary speaks with its simulators (MAVLink over TCP, in lockstep). NED and
FRD exist here beside ``drone_client/autopilot``; what goes in and out is ENU and FLU.
"""
