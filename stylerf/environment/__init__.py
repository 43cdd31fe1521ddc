"""What the process takes from its surroundings, and what it refuses to take."""
