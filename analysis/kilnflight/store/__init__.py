"""Files that are written whole or not at all: cached tables, folders, an index,
processes.
"""
