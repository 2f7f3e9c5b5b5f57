"""Whole files, cached tables, folders, the index of figures, processes."""
