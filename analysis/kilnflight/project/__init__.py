"""Infrastructure: figures, claims, notebooks, site, cache; it knows no physics."""
