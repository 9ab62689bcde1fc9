"""Sensor, feature extraction and pose."""
