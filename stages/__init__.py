"""The pipeline: one module per stage; connects what is on disk (schemas) with the mathematics (stylerf)."""
