"""A mission: search, align, approach, touch, retreat; and what ends it (docs/mission.md)."""
