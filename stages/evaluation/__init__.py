"""What the evaluate stage is made of: views brought together, measured, summarised, drawn and told."""
