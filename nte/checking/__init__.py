"""Plausibility of a clip's values and motion vectors (`nte check`)."""

from nte.checking.report import CheckReport, check
from nte.checking.show import describe, draw, undrawable

__all__ = ["CheckReport", "check", "describe", "draw", "undrawable"]
