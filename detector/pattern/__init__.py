"""The ArUco pattern: candidates, their bits, and the corners of the best."""
