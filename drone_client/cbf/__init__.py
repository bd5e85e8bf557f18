"""The safety filter: keeps the tip of the arm in a funnel that ends at the contact point.

``filter_command`` is the one door; the parts stand alone for tests and plots. docs/cbf.md derives
every formula.
"""

from __future__ import annotations

from drone_client.cbf.error_ball import error_ball_m
from drone_client.cbf.filter import FilterInput, SafeCommand, filter_command
from drone_client.cbf.freshness import Freshness, freshness
from drone_client.cbf.funnel import Funnel
from drone_client.cbf.half_space import HalfSpace, build
from drone_client.cbf.keep_out import BodyPart, KeepOut, PlaneFrame, Stance, gaps_m, half_spaces
from drone_client.cbf.keep_out_table import keep_outs_from
from drone_client.cbf.limits import alpha, closing_limit_mps, limit_outside_mps
from drone_client.cbf.next_step import Hold, checked
from drone_client.cbf.settings import FilterSettings
from drone_client.cbf.solve import Solution, solve
from drone_client.cbf.solve_several import solve_several
from drone_client.cbf.status import Status
from drone_client.cbf.variants import Barrier, CuspFunnel, Variant, paper_funnel
from drone_client.cbf.vector import Vec3

__all__ = [
    "Barrier",
    "BodyPart",
    "CuspFunnel",
    "FilterInput",
    "FilterSettings",
    "Freshness",
    "Funnel",
    "HalfSpace",
    "Hold",
    "KeepOut",
    "PlaneFrame",
    "SafeCommand",
    "Solution",
    "Stance",
    "Status",
    "Variant",
    "Vec3",
    "alpha",
    "build",
    "checked",
    "closing_limit_mps",
    "error_ball_m",
    "filter_command",
    "freshness",
    "gaps_m",
    "half_spaces",
    "keep_outs_from",
    "limit_outside_mps",
    "paper_funnel",
    "solve",
    "solve_several",
]
