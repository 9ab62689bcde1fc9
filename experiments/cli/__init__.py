"""The `mantis` command."""
