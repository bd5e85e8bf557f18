"""``drone-client doctor``: is everything well before a flight, and if not, what to change.

Facts are collected with a time limit (``collect_*``), and judged by pure functions.
"""
