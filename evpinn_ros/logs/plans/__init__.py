"""Plans in common formats: tables, tracks, answers of route services, recorded drives."""

from evpinn_ros.logs.plans.read import read_plan

__all__ = ["read_plan"]
