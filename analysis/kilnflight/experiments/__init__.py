"""What only notebooks ask: the questions of the thesis and the two papers."""
