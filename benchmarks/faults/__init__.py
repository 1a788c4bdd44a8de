"""Faults in sequence: each injected into running nodes over DDS, for `evpinn bench faults`."""
