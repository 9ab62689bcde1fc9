"""What a study shows: pages, tables, figures, files, and how numbers are written."""
