"""The thesis's link budget as printed, repaired slip by slip, and in full."""
