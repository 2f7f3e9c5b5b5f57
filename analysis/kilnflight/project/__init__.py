"""Infrastructure: figures, claims, notebooks, cache; it knows no physics."""
