"""Where the parts of the marker show in the image, in closed form. Nothing here renders."""
