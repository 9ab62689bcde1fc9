"""How good features and pose are: scatter against the Cramér–Rao bound, bias, detection and false alarms."""
