"""The closed form held against rendering, with an error budget."""
