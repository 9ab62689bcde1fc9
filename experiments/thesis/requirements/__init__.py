"""The thesis's requirements as data, each verified from this project's own results (sections 3.4, 3.6 and 8.5)."""
