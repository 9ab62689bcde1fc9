"""The virtual experiment of thesis section 8.1: pitch and range of markers over tilt, rendered, all of table 8.1."""
