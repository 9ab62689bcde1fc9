"""The thesis's link budget as printed, with its errors corrected one by one, and in full."""
