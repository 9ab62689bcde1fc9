"""What a user runs on a system of his own."""
