"""What the cameras see, simulated with known truth: the kiln and the sorting belt."""
