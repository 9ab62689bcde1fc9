"""The parameter sets that close the whole range: search on the closed form, confirmation by rendering."""
