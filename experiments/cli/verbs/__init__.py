"""The verbs of the command line, grouped; each imports what is heavy only when it runs."""
