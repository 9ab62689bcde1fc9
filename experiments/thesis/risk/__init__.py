"""Failure modes of thesis section 8.3: measured rates, and places in its risk matrix before and after mitigation."""
