"""Field of view of encoding element and marker: equations 5.17 to 5.20 printed, right and rendered (thesis section 5.6)."""
