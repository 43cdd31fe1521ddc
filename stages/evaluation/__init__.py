"""What the evaluate stage is made of: views brought together, measured, summarized, drawn and told."""
