"""Scenario to verdict: the studies and the command line."""
