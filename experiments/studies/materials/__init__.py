"""The materials, their lobes, spectra and sources."""
