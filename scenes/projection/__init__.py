"""What of the marker shows where in the image, in closed form."""
