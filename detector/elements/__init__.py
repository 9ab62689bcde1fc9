"""The encoding elements: where their blobs are, by a model of slits, tape and LED ring."""
