"""What the project publishes: figures, claims, choices, notebooks, fetched data; no
physics.
"""
